"""How long a Python process waits for the torque of a path, beside a running `palpate live --ask SOCKET`.

    ask_paths.py SOCKET SET [--points N] [--times N] [--pause S] [--exact] [--f64]

Asks about every touch of a set, as a whole and about its push alone (from the last point without
contact to the largest torque, by the answer about the whole), each resampled to so many points. Prints
one JSON object: milliseconds from having the path as lists to having the answer as lists, JSON both
ways included; with `--f64` from arrays to arrays, as base64.
"""

import argparse
import base64
import json
import socket
import time
from pathlib import Path

import numpy as np

def resample(q, points):
    """N x n_joints, rad, as lists."""
    at = np.linspace(0, len(q) - 1, points)
    return np.column_stack([np.interp(at, np.arange(len(q)), joint) for joint in np.transpose(q)]).tolist()


def push_of(path, answer):
    """The part of a path from the last point without contact to the largest torque."""
    first = int(np.argmax(np.array(answer["contacts"]) > 0))
    return path[max(first - 1, 0) : int(np.argmax(np.linalg.norm(answer["torque"], axis=1))) + 1]


def ask(lines, path, more, f64):
    """The answer about a path, and how long it took, ms."""
    path = np.array(path) if f64 else path
    begun = time.perf_counter()
    written = {"path_f64": base64.b64encode(path.astype("<f8")).decode()} if f64 else {"path": path}
    lines.write(json.dumps(written | more) + "\n")
    lines.flush()
    answer = json.loads(lines.readline())
    for name in ("torque", "torque_std") if f64 else ():
        numbers = np.frombuffer(base64.b64decode(answer.get(f"{name}_f64", "")), "<f8")
        answer[name] = numbers.reshape(-1, path.shape[1])
    took_ms = (time.perf_counter() - begun) * 1e3
    if "error" in answer:
        raise SystemExit(answer["error"])
    return answer, took_ms


def figures(ms):
    return {"median": round(float(np.median(ms)), 2), "least": round(min(ms), 2), "most": round(max(ms), 2)}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("socket")
    parser.add_argument("set", type=Path)
    parser.add_argument("--points", type=int, default=200)
    parser.add_argument("--times", type=int, default=9, help="questions about each path")
    parser.add_argument("--pause", type=float, default=0.1, help="pause between two questions, s")
    parser.add_argument("--f64", action="store_true", help="send numbers as base64, not as lists")
    parser.add_argument("--exact", action="store_true", help="use every spring at every point")
    args = parser.parse_args()

    asker = socket.socket(socket.AF_UNIX)
    asker.connect(args.socket)
    lines = asker.makefile("rw")
    more = {"exact": True} if args.exact else {}
    waited_ms, answered_ms = {"whole": [], "push": []}, {"whole": [], "push": []}
    for folder in sorted(args.set.glob("seq_*")):
        path = np.load(folder / "angles.npy")
        for name in waited_ms:
            if len(path) < 2:
                break  # it touches nothing
            path = resample(path, args.points)
            for _ in range(args.times):
                time.sleep(args.pause)
                answer, took_ms = ask(lines, path, more, args.f64)
                waited_ms[name].append(took_ms)
                answered_ms[name].append(answer["ms"])
            path = push_of(path, answer)

    print(json.dumps({
        "asked": {name: len(ms) for name, ms in waited_ms.items()},
        "waited_ms": {name: figures(ms) for name, ms in waited_ms.items() if ms},
        "of_which_palpate_ms": {name: figures(ms) for name, ms in answered_ms.items() if ms},
    }))


if __name__ == "__main__":
    main()
