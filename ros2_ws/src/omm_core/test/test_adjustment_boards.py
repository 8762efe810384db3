"""The adjustment of 25 photographs of a board ends where OpenCV's does, with the same sigma."""

import csv

import cv2
import numpy as np
import pytest
from whole_suite import shared_data

from omm_core.adjustment import Block, Group, Problem, solve

BOARDS = shared_data("calibration/bouguet_boards") / "points.csv"


def _read():
    with BOARDS.open(newline="") as file:
        rows = list(csv.DictReader(file))
    board = np.array([int(row["board"]) - 1 for row in rows])
    corners = np.array([[float(row[k]) for k in ("x_mm", "y_mm", "z_mm")] for row in rows])
    pixels = np.array([[float(row[k]) for k in ("col_px", "row_px")] for row in rows])
    return board, corners, pixels


def _matrix(lens):
    return np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1.0]])


def test_values_and_sigma_are_those_of_opencv():
    board, corners, pixels = _read()
    lens = np.array([1400.0, 1400.0, 599.5, 799.5, 0, 0, 0, 0])
    starts = []
    for i in range(board.max() + 1):
        _, rotation, place = cv2.solvePnP(
            corners[board == i], pixels[board == i], _matrix(lens), np.zeros(4)
        )
        starts.append(np.concatenate([rotation.ravel(), place.ravel()]))

    def evaluate(values):
        now, poses = values["lens"][0], values["boards"]
        predicted = np.empty_like(pixels)
        by_lens, by_board = np.empty((len(pixels), 2, 8)), np.empty((len(pixels), 2, 6))
        for i, pose in enumerate(poses):
            seen = board == i
            image, derivative = cv2.projectPoints(
                corners[seen], pose[:3], pose[3:], _matrix(now), now[4:]
            )
            predicted[seen] = image[:, 0]
            derivative = derivative.reshape(-1, 2, derivative.shape[1])
            by_board[seen], by_lens[seen] = derivative[:, :, :6], derivative[:, :, 6:14]
        return predicted, {"lens": by_lens, "boards": by_board}

    problem = Problem(
        groups=(
            Group(name="lens", values=lens[None]),
            Group(name="boards", values=np.array(starts)),
        ),
        blocks=(
            Block(
                name="corners",
                observed=pixels,
                covariance=np.tile(np.eye(2), (len(pixels), 1, 1)),
                index={"lens": np.zeros(len(pixels), dtype=int), "boards": board},
                evaluate=evaluate,
            ),
        ),
    )
    solution = solve(problem)
    assert solution.converged
    assert solution.degrees_of_freedom == 2450 - 8 - 150
    objects = [corners[board == i].astype(np.float32) for i in range(board.max() + 1)]
    images = [pixels[board == i].astype(np.float32) for i in range(board.max() + 1)]
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    rms, matrix, distortion, _, _, told, _, _ = cv2.calibrateCameraExtended(
        objects, images, (1200, 1600), _matrix(lens), np.zeros(4), flags=flags
    )
    wanted = [*matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *distortion.ravel()[:4]]
    sigma = np.sqrt(np.diag(solution.covariance_of("lens"))) * solution.sigma0
    ours = np.sqrt(np.mean(np.sum(np.square(solution.residuals["corners"]), axis=1)))
    assert ours == pytest.approx(rms, rel=1e-5)
    assert np.abs((solution.values["lens"][0] - wanted) / sigma).max() < 0.05
    told = told.ravel()[:8]
    if tuple(map(int, cv2.__version__.split(".")[:2])) < (4, 7):
        # It divided by the points minus the unknowns, where each point is two observations.
        told = told * np.sqrt((1225 - 158) / (2450 - 158))
    assert sigma == pytest.approx(told, rel=0.02)
