"""What a file of T-matrices may be of: axisymmetric or not, reciprocal, passive, handed; and its mean over turns."""

from __future__ import annotations

import numpy as np

from nacre.arrays import ComplexArray
from nacre.errors import NacreError
from nacre.families.metasurface.axial import gain, mirror_signs, reciprocal
from nacre.families.metasurface.neighbours import multipole_index
from nacre.families.metasurface.whole import file_signs, reversed_whole

AXIS_TOLERANCE = 1e-3  # of the Frobenius norm: what a mesh leaves of couplings that the symmetry forbids
TURN_TOLERANCE = 0.05  # of the scattered power that a mean over the turn leaves out; the mean field itself is .1 off
GAIN_TOLERANCE = 1e-2  # of the largest singular value that a passive particle's scattering matrix has, 1


class TMatrixFileError(NacreError):
    """A file of T-matrices cannot be used; the message is the end of a sentence that begins with the file."""


def axial(blocks: ComplexArray) -> tuple[ComplexArray, float]:
    """Return the blocks of m >= 0, `[wavelength, m, n, n']`, of the mean over the turn, and what it leaves out.

    Raises:
        TMatrixFileError: it depends too much on the turn, is handed, not reciprocal, or gives out more than it gets.
    """
    count = blocks.shape[1]
    lmax = count // 2
    m = np.arange(count)
    own = blocks[:, m, m]  # wavelength, m, n, n'
    total = np.linalg.norm(blocks.reshape(len(blocks), -1), axis=1)
    if np.any(total == 0):
        raise TMatrixFileError("holds a T-matrix of zeros")
    # over all directions of the light the scattered power goes as the squared norm
    kept = np.linalg.norm(own.reshape(len(own), -1), axis=1) / total
    turn_loss = float(np.max(np.maximum(1.0 - kept**2, 0.0)))
    if turn_loss > TURN_TOLERANCE:
        raise TMatrixFileError(
            f"is of a particle that is not axisymmetric about z: {100 * turn_loss:.2g} % of what it scatters depends "
            f"on its turn, and a mean over turns, which is what is taken, may leave out {100 * TURN_TOLERANCE:g} %; "
            'orientation = "aligned" takes it whole, of particles that all point one way'
        )
    partners = mirror_signs(lmax) * own[:, ::-1]
    uneven = np.linalg.norm((own - partners).reshape(len(own), -1), axis=1) / total
    if np.max(uneven) > AXIS_TOLERANCE:
        raise TMatrixFileError(
            f"is of a handed particle, with no mirror plane through z ({100 * np.max(uneven):.2g} % of T says so); it "
            "would turn the polarisation, which is not modelled"
        )
    half = 0.5 * (own + partners)[:, lmax:]
    even = reciprocal(half)
    if np.linalg.norm(half - even) > AXIS_TOLERANCE * np.linalg.norm(half):
        raise TMatrixFileError("is of a particle that is not reciprocal, or in other waves than the format's")
    _check_passive(even)
    return even, turn_loss if turn_loss > AXIS_TOLERANCE**2 else 0.0


def mean_blocks(blocks: ComplexArray) -> ComplexArray:
    """Return the blocks of m >= 0 of the mean over the turn, and over the mirror images that a handed one has."""
    count = blocks.shape[1]
    m = np.arange(count)
    own = blocks[:, m, m]
    return reciprocal(0.5 * (own + mirror_signs(count // 2) * own[:, ::-1])[:, count // 2 :])


def whole_or_none(blocks: ComplexArray) -> ComplexArray | None:
    """Return T over all m as `whole` has it, `[wavelength, n, n']`; None of an axisymmetric particle.

    Raises:
        TMatrixFileError: it is not reciprocal, or gives out more than it gets.
    """
    count = blocks.shape[1]
    m = np.arange(count)
    total = np.linalg.norm(blocks.reshape(len(blocks), -1), axis=1)
    coupled = blocks.copy()
    coupled[:, m, m] = 0.0
    if np.all(np.linalg.norm(coupled.reshape(len(blocks), -1), axis=1) <= AXIS_TOLERANCE * total):
        return None
    index = multipole_index(count // 2)
    row, place, sign = index.m + count // 2, index.block, file_signs(index)
    whole = blocks[:, row[:, None], row, place[:, None], place] * sign[:, None] * sign
    even = 0.5 * (whole + reversed_whole(whole))
    if np.linalg.norm(whole - even) > AXIS_TOLERANCE * np.linalg.norm(even):
        raise TMatrixFileError("is of a particle that is not reciprocal, or in other waves than the format's")
    _check_passive(even)
    return np.asarray(even)


def _check_passive(matrix: ComplexArray) -> None:
    excess = gain(matrix)
    if excess > GAIN_TOLERANCE:
        raise TMatrixFileError(
            f"is of a particle that radiates more than it gets (by {100 * excess:.2g} %): not passive"
        )
