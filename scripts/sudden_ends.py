#!/usr/bin/env python3
"""Ends `map`, `evaluate` and `live` at random moments, in four ways, and looks at what is left.

    scripts/sudden_ends.py PALPATE SET [--moments N] [--seed S] [--only map,evaluate,live]

| way  | what happens at the moment          | what must hold                                      |
|------|-------------------------------------|-----------------------------------------------------|
| kill | kill -9                             | files are whole, old or new; the next run clears up |
| term | SIGTERM                             | the same, nothing is left, `live` has saved it all  |
| full | the disk is full from then on       | old files stand, fields are saved elsewhere         |
| gone | the folder of the result is removed | fields are saved elsewhere                          |

A field is whole if it is equal to the bit to the one of an undisturbed run (`map`), or if `palpate
inspect` reads it and it has the cells that `live` said it had: at the end, or for kill -9 0.7 s before it,
as there is a checkpoint every 0.2 s. Prints a line for each fault and a table; exit code 1 if there is a
fault. Linux; makes a disk of 64 MB in a mount namespace of its own (`unshare`). `live` hears a robot in
Python over loopback. Libraries: requirements.txt, pinned.
"""

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

from soak import children

HERE = Path(__file__).parent
WAYS = ("kill", "term", "full", "gone")
ENDS = (0, 1, 130, 143, -15)  # the last before the command listens: there is nothing yet to save
COARSE = ("--spacing-m", "0.03")


def files(folder):
    """What is in a folder: bytes by relative path, hidden ones too."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if not path.is_dir()}


def fill(folder):
    """Leaves no byte free."""
    with open(folder / "filler", "wb", buffering=0) as filler:
        for size in (1 << 20, 4096):
            try:
                while filler.write(bytes(size)):
                    pass
            except OSError:
                pass


def strike(way, process, disk, out):
    """What happens at the moment."""
    if way == "kill":
        process.kill()
    elif way == "term":
        process.send_signal(signal.SIGTERM)
    elif way == "full":
        fill(disk)
    else:
        shutil.rmtree(out, ignore_errors=True)


class Bench:
    """A disk, a folder on it for results, and one elsewhere for what finds no place there."""

    def __init__(self, args, disk, elsewhere):
        self.args, self.disk, self.elsewhere = args, disk, elsewhere
        self.out = disk / "out"
        self.faults, self.codes, self.elsewheres = [], Counter(), 0
        self.environment = os.environ | {"TMPDIR": str(elsewhere), "RAYON_NUM_THREADS": "2"}
        touches = sorted(args.set.glob("seq_*"))[:3]
        self.touches = list(map(str, touches))

    def clear(self):
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir()
        (self.disk / "filler").unlink(missing_ok=True)
        for path in self.elsewhere.iterdir():
            path.unlink()

    def start(self, *words, **how):
        return subprocess.Popen([self.args.palpate, *map(str, words)], env=self.environment, text=True, **how)

    def finish(self, *words):
        """Runs a command to its end; returns what it printed."""
        process = self.start(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        printed, said = process.communicate()
        if process.returncode:
            raise RuntimeError(f"{words[0]} fails: {said}")
        return printed

    def fault(self, what):
        self.faults.append(what)
        print(f"FAULT: {what}", flush=True)

    def saved_elsewhere(self, said):
        """The field that an error says is elsewhere, and whether it is the only file there."""
        named = re.search(r"the field is in `([^`]+)` instead", said)
        there = list(self.elsewhere.iterdir())
        if not named or there != [Path(named[1])]:
            return None
        self.elsewheres += 1
        return there[0]


class Map:
    """A field from three touches: the old one, or the one of an undisturbed run."""

    def __init__(self, bench):
        self.bench = bench
        bench.clear()
        self.field = bench.out / "field.npz"
        self.words = ["map", *bench.touches, "-o", self.field, *COARSE]
        begun = time.monotonic()
        bench.finish(*self.words)
        self.took_s, self.whole = time.monotonic() - begun, self.field.read_bytes()
        bench.finish("map", bench.touches[1], "-o", self.field, *COARSE)
        self.old = self.field.read_bytes()

    def moment(self, way, rng, name):
        bench = self.bench
        bench.clear()
        before = self.old if rng.random() < 0.5 else None
        if before:
            self.field.write_bytes(before)
        process = bench.start(*self.words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        time.sleep(rng.uniform(0, 1.1) * self.took_s)
        strike(way, process, bench.disk, bench.out)
        said = process.communicate(timeout=60)[1]
        code = process.returncode
        bench.codes["map", way, code] += 1
        if way == "kill" and code != 0:
            left = {path for path in files(bench.out) if not path.endswith((".partial", ".held"))}
            self.judge(left, before, name)
            bench.finish(*self.words)
            self.judge(files(bench.out), None, name + ", run again")
            return
        if "panicked" in said or "defect" in said or code not in ENDS:
            bench.fault(f"{name}: exit code {code}, {said!r}")
        left = set(files(bench.out)) if bench.out.exists() else set()
        elsewhere = bench.saved_elsewhere(said)
        if elsewhere is not None:
            if elsewhere.read_bytes() != self.whole:
                bench.fault(f"{name}: the field saved elsewhere differs")
            elsewhere.unlink()
        elif code == 1 and not said.startswith("error") and "\nerror" not in said:
            bench.fault(f"{name}: no reason is given: {said!r}")
        elif code == 0 and way != "gone" and self.field.read_bytes() != self.whole:
            bench.fault(f"{name}: exit code 0, but the field differs")
        elif code == 1 and "there is no folder" not in said and way in ("full", "gone") and "elsewhere" not in said:
            bench.fault(f"{name}: the field is lost: {said!r}")
        if way != "gone":
            self.judge(left, before, name)
        if list(bench.elsewhere.iterdir()):
            bench.fault(f"{name}: left elsewhere: {list(bench.elsewhere.iterdir())}")

    def judge(self, left, before, name):
        if set(left) - {"field.npz"}:
            self.bench.fault(f"{name}: left behind: {sorted(left)}")
        found = self.field.read_bytes() if self.field.exists() else None
        if found not in (before, self.whole):
            self.bench.fault(f"{name}: the field is neither the old one nor complete")


class Evaluate:
    """A report and its figures."""

    def __init__(self, bench):
        self.bench = bench
        bench.clear()
        self.report = bench.out / "report"
        self.words = ["evaluate", *bench.touches, "-o", self.report, "--methods", "zero,map", *COARSE]
        begun = time.monotonic()
        self.table = bench.finish(*self.words).splitlines()[:4]
        self.took_s = time.monotonic() - begun
        self.whole = files(self.report)

    def moment(self, way, rng, name):
        bench = self.bench
        bench.clear()
        process = bench.start(*self.words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        time.sleep(rng.uniform(0, 1.1) * self.took_s)
        strike(way, process, bench.disk, bench.out)
        printed, said = process.communicate(timeout=120)
        code = process.returncode
        bench.codes["evaluate", way, code] += 1
        if way == "kill" and code != 0:
            self.judge({path for path in self.found() if not path.endswith(".partial")}, name)
            bench.finish(*self.words)
            if self.found() != self.whole:
                bench.fault(f"{name}, run again: {sorted(set(self.found()) ^ set(self.whole))} differ")
            return
        if "panicked" in said or "defect" in said or code not in ENDS:
            bench.fault(f"{name}: exit code {code}, {said!r}")
        if code == 1 and (printed.splitlines()[:4] != self.table or "error: " not in said):
            bench.fault(f"{name}: the table is lost: {printed!r} {said!r}")
        if code == 0 and way != "gone" and self.found() != self.whole:
            bench.fault(f"{name}: exit code 0, but the report differs")
        self.judge(set(self.found()), name)
        if list(bench.elsewhere.iterdir()):
            bench.fault(f"{name}: left elsewhere: {list(bench.elsewhere.iterdir())}")

    def found(self):
        return files(self.report) if self.report.exists() else {}

    def judge(self, names, name):
        """Every file is that of an undisturbed run, or a part that the next run goes on from."""
        found = self.found()
        others = [path for path in names if not path.startswith(("parts/part-", "parts/tuned-")) and found[path] != self.whole.get(path)]
        if others:
            self.bench.fault(f"{name}: incomplete, or left behind: {sorted(others)}")


class Live:
    """A field that goes on from one session to the next beside a robot at 400 Hz."""

    def __init__(self, bench, domain):
        self.bench, self.domain = bench, domain
        bench.clear()
        self.field, self.ask = bench.out / "field.npz", bench.elsewhere.parent / "ask"
        self.robot = subprocess.Popen(
            [sys.executable, HERE / "dds_robot.py", bench.args.set, "--rate", "400", "--seconds", "inf",
             "--domain", str(domain)],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        self.sessions = 0

    def moment(self, way, rng, name):
        bench = self.bench
        if self.sessions % 6 == 0:
            bench.clear()
        self.sessions += 1
        (bench.disk / "filler").unlink(missing_ok=True)
        bench.out.mkdir(exist_ok=True)
        process = bench.start(
            "live", "--localhost", "--domain", self.domain, "-o", self.field, "--resume", "--checkpoint", "0.2",
            "--ask", self.ask, "--json-lines", *COARSE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )
        lines = []
        listener = threading.Thread(target=lambda: lines.extend((time.monotonic(), line) for line in process.stdout))
        listener.start()
        time.sleep(rng.uniform(0, 4))
        network = children(process.pid)
        struck = time.monotonic()
        strike(way, process, bench.disk, bench.out)
        if way in ("full", "gone"):
            time.sleep(rng.uniform(0, 0.6))
            process.send_signal(signal.SIGTERM)
        try:
            code = process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            return bench.fault(f"{name}: it does not end")
        listener.join()
        said = process.stderr.read()
        bench.codes["live", way, code] += 1
        objects = [(at, json.loads(line)) for at, line in lines if line.endswith("\n")]
        figures = [(at, one) for at, one in objects if "mapped" in one]
        self.judge(way, name, code, said, figures, [one for _, one in objects if "frames_remembered" in one], struck)
        if any(Path(f"/proc/{child}").exists() for child in network) and not gone(network):
            bench.fault(f"{name}: its network process still runs")

    def judge(self, way, name, code, said, figures, ends, struck):
        bench = self.bench
        if "panicked" in said or "defect" in said or code not in (*ENDS, -9):
            bench.fault(f"{name}: exit code {code}, {said!r}")
        left = set(files(bench.out)) if bench.out.exists() else set()
        if way == "kill":
            known = [one["cells"] for at, one in figures if at < struck - 0.7]
            left = {path for path in left if not path.endswith((".partial", ".held"))}
        else:
            known = [one["cells"] for _, one in figures]
            if self.ask.exists():
                bench.fault(f"{name}: the socket is left")
        if left - {"field.npz"}:
            bench.fault(f"{name}: left behind: {sorted(left)}")
        elsewhere = bench.saved_elsewhere(said)
        if code == 1 and elsewhere is None and figures:
            bench.fault(f"{name}: the field is lost: {said!r}")
        if elsewhere is not None:
            bench.out.mkdir(exist_ok=True)
            (bench.disk / "filler").unlink(missing_ok=True)
            shutil.move(elsewhere, self.field)
        cells = self.cells(name)
        if known and cells < known[-1]:
            bench.fault(f"{name}: {cells} cells are kept, {known[-1]} were known")
        if ends and cells != ends[-1]["cells"]:
            bench.fault(f"{name}: {cells} cells are kept, {ends[-1]['cells']} at the end")

    def cells(self, name):
        """How many cells the field has that is kept."""
        if not self.field.exists():
            return 0
        try:
            return json.loads(self.bench.finish("inspect", "--json", self.field))["paths"][0]["cells"]
        except RuntimeError as broken:
            self.bench.fault(f"{name}: {broken}")
            return 0

    def end(self):
        self.robot.kill()


def gone(processes):
    """Whether processes end within three seconds."""
    deadline = time.monotonic() + 3
    while any(Path(f"/proc/{process}").exists() for process in processes):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def exit_codes(codes, name, way):
    """Exit codes of a command that was ended in a way."""
    ours = sorted((code, n) for (of, how, code), n in codes.items() if (of, how) == (name, way))
    return ", ".join(f"{code}: {n}" for code, n in ours)


def run(args, folder):
    disk, elsewhere = folder / "disk", folder / "elsewhere"
    disk.mkdir()
    elsewhere.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "none", disk], check=True)
    rng, bench = random.Random(args.seed), Bench(args, disk, elsewhere)
    names = args.only.split(",")
    for which, name in enumerate(names):
        scene = {"map": Map, "evaluate": Evaluate}[name](bench) if name != "live" else Live(bench, args.domain)
        for number in range(which, args.moments, len(names)):
            way = rng.choice(WAYS)
            try:
                scene.moment(way, rng, f"{name} {way} {number}")
            except (RuntimeError, OSError, subprocess.TimeoutExpired, ValueError) as error:
                bench.fault(f"{name} {way} {number}: {error}")
        if name == "live":
            scene.end()
    print(f"exit codes and how often each occurred; {bench.elsewheres} fields were saved elsewhere")
    print("| | " + " | ".join(WAYS) + " | faults |")
    for name in names:
        of_it = sum(fault.startswith(name) for fault in bench.faults)
        print(f"| `{name}` | " + " | ".join(exit_codes(bench.codes, name, way) for way in WAYS) + f" | {of_it} |")
    return 1 if bench.faults else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("palpate", type=Path)
    parser.add_argument("set", type=Path)
    parser.add_argument("--moments", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="map,evaluate,live")
    parser.add_argument("--domain", type=int, default=71)
    args = parser.parse_args()
    if "PALPATE_OWN_MOUNTS" not in os.environ:
        os.environ["PALPATE_OWN_MOUNTS"] = "1"
        os.execvp("unshare", ["unshare", "--mount", "--map-root-user", sys.executable, *sys.argv])
    args.palpate, args.set = args.palpate.resolve(), args.set.resolve()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        try:
            return run(args, folder)
        finally:
            subprocess.run(["umount", folder / "disk"], check=False)


if __name__ == "__main__":
    sys.exit(main())
