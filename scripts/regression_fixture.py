#!/usr/bin/env python3
"""Writes what scikit-learn says of a small regression, for our Gaussian process and k-NN to match.

    regression_fixture.py > crates/palpate-learn/tests/data/regression.json

Positions are standardised by the deviation of each joint, torques by one deviation for all joints,
the root mean square of theirs. Matrices are written a row a frame. Made with Python 3.11,
numpy 2.4.6 and scikit-learn 1.9.1; other versions agree to rounding.
"""

import json
import sys

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.neighbors import KNeighborsRegressor
from sklearn.preprocessing import StandardScaler

FRAMES, QUERIES, JOINTS = 40, 10, 3
SIGNAL_VARIANCE, NOISE_VARIANCE, LENGTH_SCALES = 1.7, 0.02, [0.8, 1.5, 2.5]
NEIGHBOURS, LENGTH_SCALE = 7, 0.6


def main():
    rng = np.random.default_rng(3)
    q = rng.uniform(-2.0, 2.0, (FRAMES, JOINTS)) + [0.5, -1.0, 2.0]
    queries = rng.uniform(-2.0, 2.0, (QUERIES, JOINTS)) + [0.5, -1.0, 2.0]
    tau = np.stack([3.0 * np.sin(q[:, 0]) + q[:, 1], 0.5 * q[:, 2] * q[:, 0] - 2.0], axis=1)
    tau += rng.normal(0.0, 0.1, tau.shape)

    scaler = StandardScaler().fit(q)
    z, z_queries = scaler.transform(q), scaler.transform(queries)

    mean, deviation = tau.mean(axis=0), np.sqrt(tau.var(axis=0).mean())
    kernel = ConstantKernel(SIGNAL_VARIANCE) * RBF(LENGTH_SCALES) + WhiteKernel(NOISE_VARIANCE)
    gp = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None)
    gp.fit(z, (tau - mean) / deviation)

    def weigh(distances):
        return np.exp(-(distances**2) / (2.0 * LENGTH_SCALE**2))

    knn = KNeighborsRegressor(NEIGHBOURS, weights=weigh, algorithm="brute").fit(z, tau)

    fixture = {
        "q": q.tolist(),
        "tau": tau.tolist(),
        "queries": queries.tolist(),
        "gp": {
            "signal_variance": SIGNAL_VARIANCE,
            "noise_variance": NOISE_VARIANCE,
            "length_scales": LENGTH_SCALES,
            "log_likelihood": float(gp.log_marginal_likelihood_value_),
            "predicted": (gp.predict(z_queries) * deviation + mean).tolist(),
        },
        "knn": {
            "neighbours": NEIGHBOURS,
            "length_scale": LENGTH_SCALE,
            "predicted": knn.predict(z_queries).tolist(),
        },
    }
    json.dump(fixture, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()
