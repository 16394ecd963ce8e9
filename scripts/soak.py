"""`palpate live` for a long time beside a robot at 1 kHz: memory, latency and drops, and a plot of them.

    soak.py PALPATE SET --minutes N [--rate HZ] [--restart S] [--out FOLDER] [--domain N]

Plays the touches of a set over and over by `dds_robot.py`, which is ended and started again every
`--restart` seconds. Meanwhile somebody asks about a path every second, another asker takes its answers
byte by byte, a subscriber of the clouds sleeps most of the time, and the field is written every ten
seconds. Reads the memory of palpate and of its network process from /proc, and what palpate says of
itself. Ends it by SIGTERM, and looks whether its field is whole.

Writes soak.json, soak.svg and the field into a folder, and prints what grew after the first ten minutes
(or after the first sixth). With `--viewer URL`, PALPATE sends to a Rerun viewer as well, if it was built with one.
Loopback only. Libraries: requirements.txt, pinned.
"""

import argparse
import json
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
ROBOT = HERE / "dds_robot.py"
# Between two looks at the memory, s.
LOOK_S = 5
SETTLED_S = 600
LOSSES = ("dropped", "lost", "unsent", "refused")


def sleepy_subscriber(domain):
    """Reads the clouds, ten seconds after each other: its queue holds one of each."""
    sys.path.insert(0, str(HERE))
    import dds_robot as dds
    from cyclonedds.core import Policy, Qos

    participant = dds.DomainParticipant(domain)
    qos = Qos(Policy.Reliability.Reliable(dds.duration(milliseconds=100)), Policy.History.KeepLast(1))
    topics = [dds.Topic(participant, name, dds.PointCloud2) for name in ("rt/palpate/field", "rt/palpate/contacts")]
    readers = [dds.DataReader(participant, topic, qos) for topic in topics]
    while os.getppid() != 1:
        time.sleep(10)
        for reader in readers:
            reader.take(N=10)


def connected(path):
    asker = socket.socket(socket.AF_UNIX)
    asker.connect(str(path))
    return asker


class Asker(threading.Thread):
    """Asks about a path every second; if slow, takes one byte of the answer at a time."""

    def __init__(self, path, motion, slow):
        super().__init__(daemon=True)
        self.path, self.slow, self.waited_ms, self.errors = path, slow, [], []
        self.question = (json.dumps({"path": motion}) + "\n").encode()

    def run(self):
        asker = None
        while True:
            try:
                asker = asker or connected(self.path)
                begun = time.monotonic()
                asker.sendall(self.question)
                answer = b""
                while not answer.endswith(b"\n"):
                    more = asker.recv(1 if self.slow else 1 << 16)
                    if not more:
                        raise OSError("disconnected")
                    answer += more
                    time.sleep(0.001 if self.slow else 0)
                self.waited_ms.append((begun, (time.monotonic() - begun) * 1e3))
                if "error" in json.loads(answer):
                    self.errors.append(json.loads(answer)["error"])
            except OSError as error:
                self.errors.append(str(error))
                asker = None
            time.sleep(1)


def memory_mib(process):
    """Resident memory of a process, MiB; 0 if it is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024


def children(process):
    """Processes that a process has started."""
    found = []
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            found += map(int, task.read_text().split())
        except FileNotFoundError:
            pass  # the thread has ended
    return found


def listen(stream, figures, notes):
    """Keeps what palpate says, a line of JSON each."""
    for line in stream:
        said = json.loads(line)
        if "rate_hz" in said:
            figures.append((time.monotonic(), said))
        else:
            notes.append(said)


def row(begun, live, figures):
    """What is known now."""
    at, said = figures[-1] if figures else (begun, {})
    lost = {name: said.get(name, 0) for name in LOSSES}
    lost["refused"] = sum(said.get("refused", {}).values())
    latency = said.get("latency_ms", {})
    return {
        "minutes": (time.monotonic() - begun) / 60,
        "palpate_mib": memory_mib(live.pid),
        "network_mib": sum(map(memory_mib, children(live.pid))),
        "median_ms": latency.get("median"), "p99_ms": latency.get("p99"),
        "rate_hz": said.get("rate_hz", 0), "mapped": said.get("mapped", 0), "cells": said.get("cells", 0),
        "stale_s": time.monotonic() - at, **lost,
    }


def slope(rows, key):
    """By how much a column grows in an hour, by least squares."""
    minutes = np.array([row["minutes"] for row in rows])
    return float(np.polyfit(minutes, [row[key] for row in rows], 1)[0]) * 60 if len(rows) > 2 else 0.0


def panel(rows, keys, title, top, logarithmic=False):
    """One plot of columns over minutes, as SVG, 220 high."""
    colours = ["#1b6ca8", "#c8553d", "#4c956c", "#8d6a9f"]
    scale = (lambda v: np.log10(np.maximum(v, 0.1))) if logarithmic else np.asarray
    series = [scale(np.array([row[key] if row[key] is not None else np.nan for row in rows], float)) for key in keys]
    low, high = (np.nanmin(series), np.nanmax(series)) if logarithmic else (0, max(np.nanmax(series), 1))
    high = high if high > low else low + 1
    end = max(rows[-1]["minutes"], 1e-9)
    x, y = (lambda minutes: 80 + 700 * minutes / end), (lambda value: top + 190 - 160 * (value - low) / (high - low))
    parts = [f'<text x="80" y="{top + 18}" font-weight="bold">{title}</text>']
    for part in (0, 0.25, 0.5, 0.75, 1):
        value = low + part * (high - low)
        shown = 10**value if logarithmic else value
        parts.append(f'<path d="M80 {y(value):.1f}H780" stroke="#ddd"/><text x="74" y="{y(value) + 4:.1f}" text-anchor="end">{shown:.3g}</text>')
        parts.append(f'<text x="{x(part * end):.1f}" y="{top + 206}" text-anchor="middle">{part * end:.0f}</text>')
    for number, (key, values, colour) in enumerate(zip(keys, series, colours)):
        points = " ".join(f"{x(row['minutes']):.1f},{y(v):.1f}" for row, v in zip(rows, values) if np.isfinite(v))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        parts.append(f'<text x="{420 + 95 * number}" y="{top + 18}" fill="{colour}">{key.replace("_", " ")}</text>')
    return "".join(parts)


def plot(rows):
    panels = [
        panel(rows, ["palpate_mib", "network_mib"], "resident memory, MiB", 0),
        panel(rows, ["median_ms", "p99_ms"], "sample to prediction, ms (log)", 230, logarithmic=True),
        panel(rows, list(LOSSES), "samples and messages dropped so far", 460),
        panel(rows, ["rate_hz"], "samples per second; below: time, min", 690),
    ]
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 820 920" font-family="sans-serif" font-size="12"><rect width="820" height="920" fill="white"/>{"".join(panels)}</svg>'


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("palpate")
    parser.add_argument("set", type=Path)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--rate", type=float, default=1000)
    parser.add_argument("--restart", type=float, default=300, help="time after which the publisher is restarted, s")
    parser.add_argument("--out", type=Path, default=Path("soak"))
    parser.add_argument("--domain", type=int, default=60)
    parser.add_argument("--viewer", help="address of a Rerun viewer to send to")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    field, ask = args.out / "field.npz", args.out / "ask"
    field.unlink(missing_ok=True)

    more = [f"--viewer={args.viewer}"] if args.viewer else []
    live = subprocess.Popen(
        [args.palpate, "live", "--localhost", "--domain", str(args.domain), "-o", field, "--ask", ask,
         "--json-lines", "--guard", "25", *more],
        stdout=subprocess.PIPE, stderr=open(args.out / "stderr", "w"), text=True,
    )
    figures, notes, rows, robot = [], [], [], None
    threading.Thread(target=listen, args=(live.stdout, figures, notes), daemon=True).start()
    while not ask.exists() and live.poll() is None:
        time.sleep(0.1)
    motion = np.load(sorted(args.set.glob("seq_*"))[0] / "angles.npy")[::2].tolist()
    askers = [Asker(ask, motion, slow) for slow in (False, True)]
    [asker.start() for asker in askers]
    sleeper = multiprocessing.get_context("spawn").Process(target=sleepy_subscriber, args=(args.domain,), daemon=True)
    sleeper.start()

    begun, publishers = time.monotonic(), 0
    while (left := begun + 60 * args.minutes - time.monotonic()) > 0 and live.poll() is None:
        if robot is None or robot.poll() is not None:
            life = str(min(args.restart, left + 1))
            robot = subprocess.Popen(
                [sys.executable, ROBOT, args.set, "--rate", str(args.rate), "--seconds", life, "--domain", str(args.domain)],
                stdout=subprocess.DEVNULL,
            )
            publishers += 1
        time.sleep(min(LOOK_S, max(left, 0)))
        rows.append(row(begun, live, figures))
        (args.out / "soak.json").write_text(json.dumps({"rows": rows, "notes": notes}))
        (args.out / "soak.svg").write_text(plot(rows))
    if robot.poll() is None:
        robot.kill()
    sleeper.kill()
    live.send_signal(signal.SIGTERM)
    status = live.wait(60)
    whole = subprocess.run([args.palpate, "inspect", field], stdout=subprocess.DEVNULL).returncode

    settled = [row for row in rows if row["minutes"] * 60 > min(SETTLED_S, 10 * args.minutes)]
    last = rows[-1]
    waited = [ms for _, ms in askers[0].waited_ms]
    print(json.dumps({
        "minutes": round(last["minutes"], 1), "publishers": publishers, "mapped": last["mapped"],
        **{name: last[name] for name in LOSSES},
        "growth_mib_per_h": {key: round(slope(settled, key), 2) for key in ("palpate_mib", "network_mib")},
        "memory_mib": {key: [round(settled[0][key], 1), round(last[key], 1)] for key in ("palpate_mib", "network_mib")},
        "latency_ms": {key: round(float(np.median([row[key] for row in settled if row[key]])), 2) for key in ("median_ms", "p99_ms")},
        "questions": len(waited), "question_ms": round(float(np.median(waited)), 1) if waited else None,
        "slow_answers": len(askers[1].waited_ms), "question_errors": sum((asker.errors for asker in askers), [])[:5],
        "cells": last["cells"], "exit": status, "field_whole": whole == 0, "viewer": bool(args.viewer),
        "left_in_folder": sorted(path.name for path in args.out.iterdir() if path.name.startswith(".") or path.name == "ask"),
    }))


if __name__ == "__main__":
    main()
