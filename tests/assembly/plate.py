"""A cantilevered plate in plane stress as a mesh of bilinear elements, for matrices of any size."""

import numpy as np
import scipy.sparse as sp

from jbw.assembly.joint import Joint
from jbw.assembly.matrices import matrix_model


def element(size, thickness=0.01, modulus=70e9, poisson=0.33, density=2700.0):
    """Return the consistent mass and stiffness of a square element, by 2 x 2 Gauss points."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    elastic = np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]])
    elastic *= modulus / (1 - poisson**2)
    stiffness, mass = np.zeros((8, 8)), np.zeros((8, 8))
    point = 1 / np.sqrt(3)
    for x in (-point, point):
        for y in (-point, point):
            value = (1 + x * corners[:, 0]) * (1 + y * corners[:, 1]) / 4
            along = corners[:, 0] * (1 + y * corners[:, 1]) / 4 * 2 / size
            across = corners[:, 1] * (1 + x * corners[:, 0]) / 4 * 2 / size
            strain = np.zeros((3, 8))
            strain[0, ::2], strain[1, 1::2] = along, across
            strain[2, ::2], strain[2, 1::2] = across, along
            motion = np.zeros((2, 8))
            motion[0, ::2] = motion[1, 1::2] = value
            area = size**2 / 4
            stiffness += thickness * area * strain.T @ elastic @ strain
            mass += density * thickness * area * motion.T @ motion
    return mass, stiffness


def plate(columns, rows, size=0.01):
    """Return a plate clamped at x = 0 with two elastic joints: matrices, joints, input, tip."""
    mass, stiffness = element(size)
    number = np.arange((columns + 1) * (rows + 1)).reshape(columns + 1, rows + 1)
    corners = np.stack(
        (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]), axis=-1
    ).reshape(-1, 4)
    # A slit of half the width cuts the plate at mid-length; two joints bridge it.
    slit = columns // 2
    doubled = {int(number[slit, j]): number.size + j for j in range(rows // 2)}
    cut = corners[:, 0] // (rows + 1) >= slit
    for old, new in doubled.items():
        corners[cut] = np.where(corners[cut] == old, new, corners[cut])
    places = (2 * corners[:, :, None] + np.arange(2)).reshape(-1, 8)
    row, column = np.repeat(places, 8, axis=1).ravel(), np.tile(places, (1, 8)).ravel()
    size_of_all = 2 * (number.size + rows // 2)
    assembled = [
        sp.csc_array(
            (np.tile(matrix.ravel(), len(places)), (row, column)), shape=(size_of_all,) * 2
        )
        for matrix in (mass, stiffness)
    ]
    free = np.setdiff1d(np.arange(size_of_all), (2 * number[0][:, None] + np.arange(2)).ravel())
    dofs = [(i // 2, "xy"[i % 2]) for i in free]
    model = matrix_model(*(m[free][:, free] for m in assembled), units="SI", dofs=dofs)
    ends = [(int(number[slit, j]), doubled[int(number[slit, j])]) for j in (0, rows // 4)]
    joints = [
        Joint(f"joint {i}", across=(f"{a}:x", f"{b}:x"), stiffness=2e7)
        for i, (a, b) in enumerate(ends, 1)
    ]
    tip = f"{number[-1, rows // 2]}:y"
    return model, joints, tip
