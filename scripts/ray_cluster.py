"""Evaluates several sets over 20 settings: here, on a Ray cluster of two nodes, and with a worker lost.

    python scripts/ray_cluster.py SET [SET ...] [--folds 2] [--nodes 2]

Prints for each how long it took, the ideal split of the measured times of its tasks, and whether the
numbers are those of local processes. Needs palpate, and Ray, which is started with a CPU a node.
"""

import argparse
import os
import signal
import time
from pathlib import Path
from typing import Any

import palpate.ray

SETTINGS = [
    {"estimator": {"prior_std": std}, "contact": {"friction": friction}}
    for std in (60.0, 90.0, 120.0, 180.0, 240.0)
    for friction in (0.3, 0.4, 0.5, 0.65)
]


def ideal_s(seconds: list[float], workers: int) -> float:
    """The end of the last worker if whoever is free takes the next task, in the order given."""
    ends = [0.0] * workers
    for task in seconds:
        ends[ends.index(min(ends))] += task
    return max(ends)


def workers() -> list[int]:
    """Processes that do a task for Ray."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                if (entry / "cmdline").read_bytes().startswith(b"ray::do"):
                    found.append(int(entry.name))
            except OSError:
                pass  # it ended meanwhile
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="+")
    parser.add_argument("--folds", type=int, default=2)
    parser.add_argument("--nodes", type=int, default=2)
    args = parser.parse_args()

    def run(kind: str, cluster: bool, lose: bool = False) -> dict[tuple[str, str], Any]:
        begun = time.perf_counter()
        runs = []
        keywords: dict[str, Any] = {"methods": ["map"], "folds": args.folds, "tune": False, "workers": args.nodes}
        for done in palpate.ray.evaluate(args.sets, SETTINGS, cluster=cluster, progress=False, **keywords):
            runs.append(done)
            if lose and len(runs) == 10:
                os.kill(workers()[0], signal.SIGKILL)
        wall = time.perf_counter() - begun
        ideal = ideal_s([one.seconds for one in runs], args.nodes)
        found = {(one.log, one.settings): one.get()["methods"] for one in runs}
        same = "" if kind == "processes" else f", numbers the same: {found == numbers}"
        print(
            f"{kind}: {len(runs)} runs in {wall:.1f} s, ideal {ideal:.1f} s ({wall / ideal:.3f}){same}",
            flush=True,
        )
        return found

    numbers: dict[tuple[str, str], Any] = {}
    numbers = run("processes", cluster=False)

    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # as there, all of it stays on loopback
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster()
    for _ in range(args.nodes):
        cluster.add_node(num_cpus=1, object_store_memory=80 << 20, include_dashboard=False)
    ray.init(address=cluster.address, log_to_driver=False)
    run("cluster", cluster=True)
    run("cluster, a worker killed", cluster=True, lose=True)
    best = min(numbers.values(), key=lambda rows: rows[0]["avg_relative"]["mean"])
    print("best of map:", best[0]["avg_relative"], "beside zero:", best[-1]["avg_relative"])
    ray.shutdown()
    cluster.shutdown()


if __name__ == "__main__":
    main()
