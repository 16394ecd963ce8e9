"""Long calls let other threads run, show their progress, and stop on Ctrl-C."""

import signal
import subprocess
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest
import tqdm.auto  # type: ignore[import-untyped]

import palpate

INTERRUPTED = """
import signal, sys, palpate
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background
mapper = palpate.Mapper()
print("ready", flush=True)
try:
    while True:
        mapper.map(sys.argv[1], progress=lambda done, of: print("going", flush=True))
except KeyboardInterrupt:
    before = len(mapper.field())
    assert before > 0, "nothing was learnt"
    mapper.map(sys.argv[1] + "/seq_010")
    assert len(mapper.field()) >= before
    print("usable")
"""


def test_other_threads_run_meanwhile(robot: palpate.Robot, plant: Path) -> None:
    turns, over = [time.perf_counter()], threading.Event()

    def take_turns() -> None:
        while not over.is_set():
            turns.append(time.perf_counter())
            time.sleep(0.001)

    thread = threading.Thread(target=take_turns)
    thread.start()
    started = time.perf_counter()
    palpate.Mapper(robot).map(plant / "seq_000")
    ended = time.perf_counter()
    over.set()
    thread.join()
    # If the GIL were held, the other thread could not run during the call.
    middle = [turn for turn in turns if started < turn < ended]
    pauses = [after - before for before, after in pairwise([started, *middle, ended])]
    assert max(pauses) < 0.9 * (ended - started), f"{len(middle)} turns, {max(pauses):.2f} s without one"


def test_ctrl_c_stops_a_map_and_leaves_the_mapper_usable(plant: Path) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, str(plant)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    assert child.stdout.readline() == "going\n"
    child.send_signal(signal.SIGINT)
    said, _ = child.communicate(timeout=180)
    assert said.endswith("usable\n"), said
    assert child.returncode == 0


def test_progress_is_reported_and_may_stop_the_work(
    robot: palpate.Robot, plant: Path, field: palpate.Field
) -> None:
    reported: list[tuple[int, int | None]] = []
    mapper = palpate.Mapper(robot)
    report = mapper.map(plant / "seq_000", progress=lambda done, steps: reported.append((done, steps)))
    assert reported[-1] == (report["frames"], report["frames"])
    assert reported == sorted(reported)

    def enough(done: int, steps: int | None) -> None:
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        mapper.map(plant, progress=enough)
    assert len(mapper.field()) < len(field), "it went on to the end"
    assert mapper.map(plant / "seq_001", progress=False)["frames"] == 400
    with pytest.raises(TypeError, match="wanted None, True, False or a callable"):
        mapper.map(plant, progress=3)  # type: ignore[arg-type]


def test_a_call_shows_one_progress_bar(
    robot: palpate.Robot, plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bars: list[tuple[str, int]] = []

    class Bar(tqdm.auto.tqdm):  # type: ignore[misc]
        def close(self) -> None:
            if not self.disable:
                bars.append((self.desc, self.n))
            super().close()

    monkeypatch.setattr(tqdm.auto, "tqdm", Bar)
    mapper = palpate.Mapper(robot)
    report = mapper.map(plant / "seq_000", progress=True)
    assert len(bars) == 1 and bars[0][0].startswith("learning") and bars[0][1] == report["frames"]
    bars.clear()
    mapper.map(plant / "seq_001", progress=False)
    mapper.map(plant / "seq_002")  # without a terminal, no bar is shown
    assert bars == []


def test_a_progress_callback_cannot_use_the_mapper_at_work(robot: palpate.Robot, plant: Path) -> None:
    mapper = palpate.Mapper(robot)
    with pytest.raises(palpate.PalpateError, match="a `progress` callback cannot use it"):
        mapper.map(plant / "seq_000", progress=lambda done, steps: mapper.field())


def test_threads_take_turns(robot: palpate.Robot, plant: Path) -> None:
    mapper = palpate.Mapper(robot)
    work = threading.Thread(target=mapper.map, args=(plant / "seq_000",))
    work.start()
    while work.is_alive():
        assert len(mapper.field()) >= 0
        time.sleep(0.01)
    work.join()
    alone = palpate.Mapper(robot)
    alone.map(plant / "seq_000")
    assert mapper.field().stiffness.tobytes() == alone.field().stiffness.tobytes()


def test_an_answer_has_the_uncertainty_and_the_contacts_of_each_point(
    mapped: tuple[palpate.Mapper, object], touch: palpate.Touch
) -> None:
    answer = mapped[0].ask(touch.q[::8])
    assert answer.torque.shape == answer.torque_std.shape == (50, 7)
    assert (answer.torque_std >= 0).all() and (answer.known <= answer.contacts).all()
    assert answer.contacts.max() > 0 and not answer.goes_on and 1 < answer.stops <= 50


def test_import_loads_no_module_that_only_some_calls_need() -> None:
    code = "import palpate, sys; print([m for m in ('tqdm', 'matplotlib', 'IPython') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
