"""How long a Python process waits for the torque of a path, beside a running `palpate live --ask SOCKET`.

    ask_paths.py SOCKET SET [--points 200] [--times 9] [--exact]

Asks about every touch of a set, as a whole and about its push alone (from the first frame at a tenth
of the largest torque to that of the largest), each resampled to so many points. Prints one JSON
object: milliseconds from having the path as lists to having the answer as lists, JSON both ways
included.
"""

import argparse
import json
import socket
import time
from pathlib import Path

import numpy as np

STILL = 5  # frames free of contact at the start of a touch


def paths(folder, points):
    """The paths of a touch, by name."""
    q, tau = np.load(folder / "angles.npy"), np.load(folder / "torques.npy")
    felt = np.linalg.norm(tau - tau[:STILL].mean(axis=0), axis=1)
    push = slice(int(np.argmax(felt >= felt.max() / 10)), int(np.argmax(felt)) + 1)
    return {"whole": resample(q, points), "push": resample(q[push], points)}


def resample(q, points):
    """N x n_joints, rad, as lists."""
    at = np.linspace(0, len(q) - 1, points)
    return np.column_stack([np.interp(at, np.arange(len(q)), joint) for joint in q.T]).tolist()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("socket")
    parser.add_argument("set", type=Path)
    parser.add_argument("--points", type=int, default=200)
    parser.add_argument("--times", type=int, default=9, help="questions about each path")
    parser.add_argument("--pause", type=float, default=0.1, help="between two questions, s")
    parser.add_argument("--exact", action="store_true", help="every spring at every point")
    args = parser.parse_args()

    asker = socket.socket(socket.AF_UNIX)
    asker.connect(args.socket)
    lines = asker.makefile("rw")
    waited_ms, answered_ms = {}, {}
    for folder in sorted(args.set.glob("seq_*")):
        for name, path in paths(folder, args.points).items():
            for _ in range(args.times):
                time.sleep(args.pause)
                begun = time.perf_counter()
                lines.write(json.dumps({"path": path} | ({"exact": True} if args.exact else {})) + "\n")
                lines.flush()
                answer = json.loads(lines.readline())
                waited_ms.setdefault(name, []).append((time.perf_counter() - begun) * 1e3)
                if "error" in answer:
                    raise SystemExit(answer["error"])
                answered_ms.setdefault(name, []).append(answer["ms"])

    def figures(ms):
        return {"median": round(float(np.median(ms)), 2), "least": round(min(ms), 2), "most": round(max(ms), 2)}

    print(json.dumps({
        "asked": {name: len(ms) for name, ms in waited_ms.items()},
        "waited_ms": {name: figures(ms) for name, ms in waited_ms.items()},
        "of_which_palpate_ms": {name: figures(ms) for name, ms in answered_ms.items()},
    }))


if __name__ == "__main__":
    main()
