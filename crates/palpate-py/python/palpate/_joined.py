"""Joins the shares of an evaluation whose folds were computed separately."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from ._palpate import summarised
from .results import Evaluation, HeldOutTouch, MethodRow, Share


def joined(shares: Sequence[Share]) -> Evaluation:
    """The evaluation of all folds; share `i` of `n` contains folds `i`, `i + n` and so on."""
    first = shares[0]
    places: list[tuple[int, int, HeldOutTouch, dict[str, Any]]] = []
    for share in shares:
        in_fold: Counter[int] = Counter()
        for touch, bands in zip(share["touches"], share["bands"], strict=True):
            # Touch `t` of a log is in fold `t mod folds`.
            places.append((in_fold[touch["fold"]], touch["fold"], touch, bands))
            in_fold[touch["fold"]] += 1
    places.sort(key=lambda place: place[:2])

    def row(name: str) -> MethodRow:
        errors = [touch["errors"][name] for _, _, touch, _ in places]
        return summarised(name, errors, [bands[name] for _, _, _, bands in places])

    tuned = None
    if first["tuned"] is not None:
        each = [iter(share["tuned"] or []) for share in shares]
        folds = sum(len(share["tuned"] or []) for share in shares)
        tuned = [next(each[fold % len(shares)]) for fold in range(folds)]
    return {
        "methods": [row(method["name"]) for method in first["methods"]],
        "touches": [touch for _, _, touch, _ in places],
        "against": first["against"],
        "joint_names": first["joint_names"],
        "tuned": tuned,
    }
