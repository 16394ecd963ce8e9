#!/usr/bin/env python3
"""Compares the order in which `Field.next` proposes touches with random ones, by the error on touches that are tested.

    python scripts/next_touch.py SET [SET ...] --out FOLDER [--simulate] [--splits 5] [--orders 20] [--processes 2]
        [--settings FILE.toml]

A third of each set's touches is kept for testing, in several splits; their joint paths, without torques, are the task.
The others are learned one after the other, in random orders and in the order that `next` proposes, each time from those
left and by the field so far. After each touch the error on the tested ones is taken, relative to predicting zero.

With --simulate, every touch is made when it is chosen: MuJoCo moves the arm along its path through the set's object, as
touch_again.py does, with new noise. Otherwise the set's recorded torques are used. Without --settings, the field is learned
under the shipped ones.

FOLDER gets curves.json and curves.svg, and a table is printed: the error of `next` after half of the touches, beside that
of random orders after half and after two thirds. Figures are of simulated sets. Needs palpate, numpy, matplotlib (and
mujoco and scipy with --simulate), all from PyPI.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import palpate

EVERY = 4  # learned and tested are every Nth frame: contacts follow the motion between them


class Recorded:
    """The touches of a set as they were recorded."""

    def __init__(self, folder):
        self.touches = {}
        for touch in sorted(Path(folder).glob("seq_*")):
            angles, torques = (np.load(touch / f"{name}.npy") for name in ("angles", "torques"))
            self.touches[len(self.touches)] = (angles, torques)

    def path(self, number):
        return self.touches[number][0][::EVERY]

    def touch(self, number):
        angles, torques = self.touches[number]
        return palpate.Touch(angles[::EVERY], torques[::EVERY], name=str(number))


class Simulated(Recorded):
    """The same touches, made anew when they are first asked for."""

    def __init__(self, folder):
        from touch_again import ScenePlayer

        super().__init__(folder)
        self.player, self.rng, self.made = ScenePlayer(folder), np.random.default_rng(5), {}

    def touch(self, number):
        if number not in self.made:
            angles = self.touches[number][0]
            log = self.player.measured(self.player.touch(angles), self.rng)
            self.made[number] = palpate.Touch(log["angles"][::EVERY], log["torques"][::EVERY], name=str(number))
        return self.made[number]


def error(field, tests):
    """Mean error of the tested touches over that of predicting zero."""
    overall = field.score(tests, progress=False)["overall"]
    return overall["avg_error"] / overall["zero"]["avg_error"]


def curve(source, tests, candidates, choose, settings):
    """Errors after 1, 2, ... touches; `choose` takes the field so far, or None, and the numbers that are left."""
    mapper, left, errors, order = palpate.Mapper(settings=settings), list(candidates), [], []
    while left:
        number = choose(mapper.field(), left)
        left.remove(number)
        order.append(number)
        mapper.map(source.touch(number), progress=False)
        errors.append(error(mapper.field(), tests))
    return {"order": order, "errors": errors}


def split_of(work):
    """All curves of one split of one set."""
    folder, simulate, split, orders, settings = work
    source = (Simulated if simulate else Recorded)(folder)
    numbers = np.random.default_rng(100 + split).permutation(len(source.touches)).tolist()
    count = round(len(numbers) / 3)
    test, candidates = sorted(numbers[:count]), sorted(numbers[count:])
    tests = [source.touch(number) for number in test]
    task = [source.path(number) for number in test]

    def proposed(field, left):
        found = field.next([source.path(number) for number in left], task, count=1, progress=False)
        return left[found["proposals"][0]["candidate"]] if found["proposals"] else left[0]

    rng = np.random.default_rng(split)
    drawn = lambda _, left: int(rng.choice(left))  # noqa: E731
    random = [curve(source, tests, candidates, drawn, settings) for _ in range(orders)]
    ordered = curve(source, tests, candidates, proposed, settings)
    return {"set": Path(folder).name, "test": test, "next": ordered, "random": random}


def picture(results, path):
    """The curves of each set, mean over its splits."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    sets = list(dict.fromkeys(result["set"] for result in results))
    figure, axes = pyplot.subplots(1, len(sets), figsize=(3.6 * len(sets), 3.2), squeeze=False, sharey=True)
    for axis, name in zip(axes[0], sets):
        for result in (result for result in results if result["set"] == name):
            n = range(1, len(result["next"]["errors"]) + 1)
            axis.plot(n, np.mean([own["errors"] for own in result["random"]], axis=0), color="0.75", lw=0.8)
            axis.plot(n, result["next"]["errors"], color="#9ecae1", lw=0.8)
        random, proposed = means(results, name)
        axis.plot(range(1, len(random) + 1), random, color="0.3", label="random, mean")
        axis.plot(range(1, len(random) + 1), proposed, color="#08519c", label="next")
        axis.set(title=f"{name} (simulated)", xlabel="touches learned")
        axis.axhline(1.0, color="0.6", lw=0.6, ls=":")
    axes[0][0].set_ylabel("error / error of zero")
    axes[0][0].legend(frameon=False)
    figure.tight_layout()
    figure.savefig(path)


def means(results, name):
    """Mean curves of a set: of random orders, and of `next`."""
    own = [result for result in results if result["set"] == name]
    random = np.mean([[curve["errors"] for curve in result["random"]] for result in own], axis=(0, 1))
    return random, np.mean([result["next"]["errors"] for result in own], axis=0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--simulate", action="store_true")
    parser.add_argument("--splits", type=int, default=5)
    parser.add_argument("--orders", type=int, default=20)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--settings", type=Path)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    work = [(name, args.simulate, split, args.orders, args.settings) for name in args.sets for split in range(args.splits)]
    with ProcessPoolExecutor(args.processes) as pool:
        results = []
        for number, result in enumerate(pool.map(split_of, work), 1):
            results.append(result)
            print(f"{number} of {len(work)}: {result['set']}", flush=True)
    (args.out / "curves.json").write_text(json.dumps(results))
    picture(results, args.out / "curves.svg")
    rows = []
    for name in dict.fromkeys(result["set"] for result in results):
        random, proposed = means(results, name)
        half, most = len(random) // 2, round(2 * len(random) / 3)
        rows.append([proposed[half - 1], random[half - 1], random[most - 1]])
        print(f"{name:14} next after {half}: {rows[-1][0]:.3f}   random after {half}: {rows[-1][1]:.3f}, after {most}: {rows[-1][2]:.3f}")
        print("   next  ", " ".join(f"{own:.3f}" for own in proposed))
        print("   random", " ".join(f"{own:.3f}" for own in random))
    print("mean           next at half %.3f   random at half %.3f, at two thirds %.3f" % tuple(np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
