"""Writes npz files with numpy, and checks with numpy the file that palpate wrote.

    python npz.py          writes numpy.npz and openvsf.npz
    python npz.py check    loads palpate.npz (written by tests/npz.rs) without pickle
"""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
POINTS = np.array([[0.0, 0.1, 0.2], [1.0, 1.1, 1.2], [-1.0, 0.5, 0.25]])


def make():
    np.savez_compressed(
        HERE / "numpy.npz",
        points=np.asfortranarray(POINTS),
        K=np.array([10.0, 0.0, 250.5], dtype=">f8"),
        K_std=np.array([1.0, 2.0, 3.0], dtype="f4"),
        N_obs=np.array([4, 5, 6], dtype="i8"),
        lattice=np.array([-1.2, -1.2, 0.0, 0.012, 200, 200, 100]),
        cells=np.array([7, 8, 39999], dtype="u4"),
        cube=np.asfortranarray(np.arange(24, dtype="i2").reshape(2, 3, 4)),
        scalar=np.float64(2.5),
    )
    # As OpenVSF's PointVSF.save does: single precision, text, and a pickled dictionary.
    np.savez(
        HERE / "openvsf.npz",
        points=POINTS.astype("f4"),
        axis_mode="isotropic",
        features={"K_std": np.ones(3, dtype="f4")},
        K=np.array([10.0, 0.0, 250.5], dtype="f4"),
    )


def check():
    with np.load(HERE / "palpate.npz", allow_pickle=False) as field:
        assert field.files == ["points", "K", "K_std", "N_obs", "lattice", "cells", "settings"]
        assert np.array_equal(field["points"], POINTS) and field["points"].dtype == np.float64
        assert np.array_equal(field["K"], [10.0, 0.0, 250.5]) and field["K"].dtype == np.float64
        assert np.array_equal(field["K_std"], [1.0, 2.0, 3.0])
        assert np.array_equal(field["N_obs"], [4, 5, 6]) and field["N_obs"].dtype == np.uint32
        assert np.array_equal(field["lattice"], [-1.2, -1.2, 0.0, 0.012, 200, 200, 100])
        assert np.array_equal(field["cells"], [7, 8, 39999]) and field["cells"].dtype == np.uint32
        assert bytes(field["settings"]).decode() == '{"spacing_m": 0.012, "name": "süß"}'
    print("numpy reads what we wrote")


check() if sys.argv[1:] == ["check"] else make()
