"""An evaluation whose folds were shared out, put together again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from ._palpate import summarised
from .results import Evaluation, LeftOut


def joined(shares: Sequence[Evaluation]) -> Evaluation:
    """The evaluation of all folds, of which share `i` of `n` has folds `i`, `i + n` and so on."""
    first = shares[0]
    places: list[tuple[int, int, LeftOut]] = []
    for share in shares:
        in_fold: Counter[int] = Counter()
        for touch in share["touches"]:  # touch `t` of a log is in fold `t mod folds`
            places.append((in_fold[touch["fold"]], touch["fold"], touch))
            in_fold[touch["fold"]] += 1
    touches = [touch for _, _, touch in sorted(places, key=lambda place: place[:2])]
    names = [row["name"] for row in first["methods"]]
    rows = [summarised(name, [touch["errors"][name] for touch in touches]) for name in names]
    tuned = None
    if first["tuned"] is not None:
        each = [iter(share["tuned"] or []) for share in shares]
        folds = sum(len(share["tuned"] or []) for share in shares)
        tuned = [next(each[fold % len(shares)]) for fold in range(folds)]
    return {**first, "methods": rows, "touches": touches, "tuned": tuned}
