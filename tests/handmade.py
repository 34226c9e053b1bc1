"""Results made by hand, for tests of what is drawn and said of them."""

import h5py
import numpy as np

COUNTS = {1: (9, 1, 1), 2: (8, 6, 1), 3: (6, 4, 5)}


def made(directory, dim: int, steps=(1, 2), mode="newton") -> dict:
    """A result of a block of unit cells that is bent, and its summary; stress xx goes from -n to n across y or x."""
    grid = np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in COUNTS[dim]], indexing="ij"), axis=-1)
    X = grid.transpose(2, 1, 0, 3).reshape(-1, 3) * (np.arange(3) < dim)
    n = len(X)
    with h5py.File(directory / "fields.h5", "w") as file:
        file["position"], file["spacing"], file["volume"] = X, np.ones(n), np.ones(n)
        for step in steps:
            group = file.create_group(f"{step:05d}")
            group["u"] = 0.1 * step * X[:, [0, 0, 0]] * [0, dim > 1, 0]
            group["F"] = np.tile(np.eye(3).ravel(), (n, 1))
            stress = np.zeros((n, 3, 3))
            stress[:, 0, 0] = step * (X[:, min(dim, 2) - 1] - X[:, min(dim, 2) - 1].mean() + 0.1)
            stress[:, 1, 1] = 2.0
            group["stress"] = stress.reshape(n, 9)
            group["damage"] = (X[:, 0] > 4) * 0.5
    rows = [{"step": s, "time": 0.5 * s, "residual_norms": [10.0, 1e-3, 0.0], "residual_scale": 100.0} for s in steps]
    return {
        "dim": dim, "units": {"length": "mm", "force": "N", "time": "s"}, "title": "A $block$", "case": "block",
        "steps": rows, "choices": {"mode": mode},
    }  # fmt: skip
