"""Compare two scenes by appearance: covariances and colours, not floats."""

from __future__ import annotations

import numpy as np

from gs_codec.rendering.harmonics import sh_basis
from gs_codec.scene import Scene


def matrix_of(turn: np.ndarray, factor: float = 1.0, shift: object = 0.0) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = factor * turn, shift
    return matrix


def some_turn(seed: int, mirrored: bool = False) -> np.ndarray:
    """A random orthogonal matrix, computed differently from the code under test."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn if (np.linalg.det(turn) < 0) == mirrored else -turn


def colours(scene: Scene, directions: np.ndarray) -> np.ndarray:
    """SH-AC part of each Gaussian's colour, ``(3, N)``, in its direction."""
    basis = np.zeros((15, scene.count))
    for i, direction in enumerate(directions.T):
        sh_basis.py_func(*direction, 15, basis[:, i])
    rest = scene.f_rest.reshape(3, -1, scene.count)
    return (rest * basis[: rest.shape[1]]).sum(axis=1)


def covariance(scene: Scene) -> np.ndarray:
    """Covariances ``(N, 3, 3)``."""
    w, x, y, z = (scene.rot / np.linalg.norm(scene.rot, axis=0)).astype(np.float64)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    variance = np.exp(2 * scene.log_scale.T.astype(np.float64))
    return (turn * variance[:, None]) @ turn.transpose(0, 2, 1)


def assert_seen_alike(scene: Scene, turned: Scene, turn: np.ndarray) -> None:
    expected = turn @ covariance(scene) @ turn.T
    np.testing.assert_allclose(
        covariance(turned), expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max()
    )
    away = np.random.default_rng(5).normal(size=(3, scene.count))
    away = (away / np.linalg.norm(away, axis=0)).astype(np.float32)
    seen = colours(scene, away), colours(turned, (turn @ away).astype(np.float32))
    np.testing.assert_allclose(*seen, atol=1e-5)


def assert_held_exactly(back: Scene, scene: Scene) -> None:
    """Equal, except for the rounding of values stored in linear form, and quaternion norms."""
    for group in ("positions", "f_dc", "f_rest"):
        np.testing.assert_array_equal(getattr(back, group), getattr(scene, group))
    np.testing.assert_allclose(back.log_scale, scene.log_scale, atol=1e-6)
    np.testing.assert_allclose(back.opacity, scene.opacity, atol=1e-3)
    unit = scene.rot / np.linalg.norm(scene.rot, axis=0)
    np.testing.assert_allclose(np.abs((back.rot * unit).sum(axis=0)), 1, atol=1e-6)
