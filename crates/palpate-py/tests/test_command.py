"""The package installs the command `palpate`, which behaves like the program built without Python."""

import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import palpate


def test_the_command_has_the_version_of_the_package(command: Path) -> None:
    for call in ([command], [sys.executable, "-m", "palpate"]):
        done = subprocess.run([*call, "--version"], capture_output=True, text=True)
        assert (done.returncode, done.stdout) == (0, f"palpate {palpate.__version__}\n")


def test_the_command_ends_with_the_codes_of_the_program(command: Path, tmp_path: Path) -> None:
    field = tmp_path / "field.npz"
    done = subprocess.run([command, "map", "nothing", "-o", field], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr[:25]) == (1, "", "error: `nothing` does not")
    done = subprocess.run([command, "mop"], capture_output=True, text=True)
    assert done.returncode == 2 and "similar subcommand exists: 'map'" in done.stderr
    with subprocess.Popen([command, "demo", "--help"], stdout=subprocess.PIPE) as piped:
        assert piped.stdout is not None
        piped.stdout.close()  # as `| head` does
    assert piped.returncode in (0, 1)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_stops_the_command_and_writes_nothing(command: Path, plant: Path, tmp_path: Path) -> None:
    call = list(map(str, (command, "evaluate", plant, "-o", tmp_path / "out")))
    with subprocess.Popen(call, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        line = running.stderr.readline()  # waits until it has begun to work
        running.send_signal(signal.SIGINT)
        stderr = line + running.stderr.read()
    assert running.returncode == 130, stderr
    assert "Traceback" not in stderr and "stopping" in stderr


def test_live_finds_its_network_process_in_the_package(command: Path) -> None:
    domain = str(random.randrange(120, 200))
    call = [str(command), "live", "--robot", "kinova_gen3", "--localhost", "--domain", domain, "--duration", "1"]
    done = subprocess.run(call, capture_output=True, text=True, env={**os.environ, "TERM": "dumb"})
    assert done.returncode == 0, done.stderr
