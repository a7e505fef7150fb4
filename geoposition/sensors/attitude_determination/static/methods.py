"""Attitude of one epoch from directions: TRIAD, Davenport's q, SVD, QUEST and FOAM.

All solve for R_reference_body from unit vectors `body` and `reference` (..., m, 3) with standard
deviations `sigma_rad` per axis across them; leading axes are epochs, solved at once. A vector or
sigma that is not a finite number, or a zero vector, is absent. TRIAD uses two vectors; the others
minimise Wahba's loss, the sum of |b − A r|^2 / sigma^2, and differ by rounding only: theirs is
chi-squared with 2 m − 3 degrees of freedom.

*Source*: Wahba 1965; Markley & Crassidis 2014, chapter 5; T (3.1)–(3.13).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from geoposition.arrays import BoolArray, FlagArray, FloatArray, IntArray, as_components, read_only
from geoposition.errors import ArgumentError
from geoposition.flags import Flag
from geoposition.sensors.attitude_determination.static.covariance import (
    fisher_covariance,
    geometry_is_weak,
    triad_covariance,
)
from geoposition.sensors.attitude_determination.static.wahba import (
    adjugate,
    davenport_matrix,
    largest_eigenvalue,
    quest_quaternion,
)
from geoposition.sensors.kinematics import quat_product_xyzw

StaticMethod: TypeAlias = Literal["triad", "q", "svd", "quest", "foam"]


@dataclass(frozen=True, slots=True, eq=False)
class StaticAttitude:
    """Attitudes (...): `quat_xyzw` (..., 4) of R_reference_body, with scalar >= 0.

    `covariance_rad2` (..., 3, 3) of the rotation vector in the body, `loss` (...) Wahba's and
    `vectors` (...) how many were used. NaN where `flag` (...) is not OK: `TOO_FEW_RAYS` with
    fewer than two vectors, `WEAK_GEOMETRY` where they are nearly parallel, `NOT_CONVERGED` where
    rounding defeats the method (FOAM, all but parallel).
    """

    quat_xyzw: FloatArray
    covariance_rad2: FloatArray
    loss: FloatArray
    vectors: IntArray
    flag: FlagArray

    @property
    def R_reference_body(self) -> Rotation:
        """The attitudes as rotations, of epochs that all have one."""
        if np.any(self.flag != Flag.OK):
            raise ArgumentError("static attitude: some epochs have none, select by flag first")
        return Rotation.from_quat(np.array(self.quat_xyzw))


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Unit vectors with weights; absent ones have weight 0 and a harmless direction."""

    body: FloatArray
    reference: FloatArray
    sigma: FloatArray
    present: BoolArray
    flag: FlagArray

    @property
    def weight(self) -> FloatArray:
        """Weights (..., m) that sum to one."""
        raw = np.where(self.present, self.sigma**-2.0, 0.0)
        total = np.sum(raw, axis=-1, keepdims=True)
        return raw / np.where(total > 0.0, total, 1.0)

    @property
    def profile(self) -> FloatArray:
        """B = sum w b r^T (..., 3, 3); that of no rotation where there is no answer."""
        b = np.einsum("...m,...mi,...mj->...ij", self.weight, self.body, self.reference)
        return np.where((self.flag == Flag.OK)[..., None, None], b, np.diag([0.5, 0.3, 0.2]))


def solve(
    method: StaticMethod, body: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike
) -> StaticAttitude:
    """Solve by the method named."""
    methods: dict[str, Callable[[ArrayLike, ArrayLike, ArrayLike], StaticAttitude]] = {
        "triad": triad,
        "q": davenport_q,
        "svd": svd,
        "quest": quest,
        "foam": foam,
    }
    if method not in methods:
        raise ArgumentError(f"static method: {', '.join(methods)} expected, got {method!r}")
    return methods[method](body, reference, sigma_rad)


def triad(body: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> StaticAttitude:
    """Two vectors: the most precise one is met, the other fixes the turn about it.

    Of more than two, the second is the one that fixes that turn best. *Source*: T (3.3)–(3.7);
    Shuster & Oh 1981.
    """
    problem = _problem(body, reference, sigma_rad)
    sigma = np.where(problem.present, problem.sigma, np.inf)
    anchor = np.argmin(sigma, axis=-1)[..., None]
    r1 = np.take_along_axis(problem.reference, anchor[..., None], axis=-2)
    sine = np.linalg.norm(np.cross(r1, problem.reference), axis=-1)
    # The turn's variance is (sigma_2^2 + cos^2 sigma_1^2) / sin^2.
    s1 = np.take_along_axis(sigma, anchor, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = (sigma**2 + (1.0 - sine**2) * s1**2) / sine**2
    variance = np.where(np.isfinite(variance), variance, np.inf)
    np.put_along_axis(variance, anchor, np.inf, axis=-1)
    other = np.argmin(variance, axis=-1)[..., None]
    pick = np.concatenate([anchor, other], axis=-1)
    two = _Problem(
        np.take_along_axis(problem.body, pick[..., None], axis=-2),
        np.take_along_axis(problem.reference, pick[..., None], axis=-2),
        np.take_along_axis(problem.sigma, pick, axis=-1),
        np.take_along_axis(problem.present, pick, axis=-1),
        problem.flag,
    )
    covariance, weak = triad_covariance(two.body, two.reference, two.sigma)
    two = replace(two, flag=_flagged(two.flag, weak, Flag.WEAK_GEOMETRY))
    ok = two.flag == Flag.OK
    frames = [
        _orthogonal_frame(np.where(ok[..., None, None], v, np.eye(3)[:2]))
        for v in (two.reference, two.body)
    ]
    quat = _quat_of_matrix(frames[0] @ np.swapaxes(frames[1], -1, -2))
    return _finished(two, quat, covariance)


def davenport_q(body: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> StaticAttitude:
    """Eigenvector of Davenport's matrix with the largest eigenvalue. *Source*: T (3.10)–(3.13)."""
    problem = _wahba_problem(body, reference, sigma_rad)
    _, vectors = np.linalg.eigh(davenport_matrix(problem.profile))
    return _optimal(problem, vectors[..., :, -1])


def svd(body: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> StaticAttitude:
    """Singular value decomposition of the attitude profile. *Source*: T (3.8)–(3.9)."""
    problem = _wahba_problem(body, reference, sigma_rad)
    u, _, vt = np.linalg.svd(problem.profile)
    sign = np.ones(u.shape[:-1])
    sign[..., 2] = np.linalg.det(u) * np.linalg.det(vt)
    matrix = (u * sign[..., None, :]) @ vt
    return _optimal(problem, _quat_of_matrix(np.swapaxes(matrix, -1, -2)))


def quest(body: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> StaticAttitude:
    """Largest eigenvalue by Newton's iteration, quaternion in closed form.

    The closed form fails for turns near 180 degrees; so each problem is also solved with the
    reference turned by 180 degrees about each axis (sequential rotations), and the best
    conditioned of the four solutions taken. *Source*: Shuster & Oh 1981.
    """
    problem = _wahba_problem(body, reference, sigma_rad)
    profile = problem.profile
    eigenvalue = largest_eigenvalue(profile)
    # Axis of four: no turn, then about x, y, z; B R with R = diag of signs.
    signs = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=np.float64)
    turns = np.array([[0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], dtype=np.float64)
    turned = profile[..., None, :, :] * signs[:, None, :]
    quat = quest_quaternion(turned, eigenvalue[..., None])
    best = np.argmax(np.linalg.norm(quat, axis=-1), axis=-1)
    chosen = np.take_along_axis(quat, best[..., None, None], axis=-2)[..., 0, :]
    quat = quat_product_xyzw(turns[best], chosen)
    return _optimal(problem, quat)


def foam(body: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> StaticAttitude:
    """Fast optimal attitude matrix: the matrix itself in closed form from the eigenvalue.

    *Source*: Markley 1993.
    """
    problem = _wahba_problem(body, reference, sigma_rad)
    b = problem.profile
    eigenvalue = largest_eigenvalue(b)
    size = np.sum(b * b, axis=(-2, -1))
    kappa = 0.5 * (eigenvalue**2 - size)
    zeta = kappa * eigenvalue - np.linalg.det(b)
    transposed = np.swapaxes(b, -1, -2)
    matrix = (
        (kappa + size)[..., None, None] * b
        + eigenvalue[..., None, None] * np.swapaxes(adjugate(b), -1, -2)
        - b @ transposed @ b
    )
    matrix = matrix / np.where(zeta > 0.0, zeta, 1.0)[..., None, None]
    # Rounding in a geometry that is all but weak can leave no rotation at all.
    lost = ~(np.linalg.det(matrix) > 0.5)
    matrix = np.where(lost[..., None, None], np.eye(3), matrix)
    problem = replace(problem, flag=_flagged(problem.flag, lost, Flag.NOT_CONVERGED))
    return _optimal(problem, _quat_of_matrix(np.swapaxes(matrix, -1, -2)))


def _problem(body: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> _Problem:
    vectors = [as_components(v, 3, name) for v, name in ((body, "body"), (reference, "reference"))]
    if vectors[0].ndim < 2 or vectors[0].shape != vectors[1].shape:
        raise ArgumentError(
            f"static attitude: body and reference (..., m, 3) alike expected, got "
            f"{vectors[0].shape} and {vectors[1].shape}"
        )
    shape = vectors[0].shape[:-1]
    try:
        sigma = np.broadcast_to(np.asarray(sigma_rad, dtype=np.float64), shape)
    except ValueError:
        raise ArgumentError(f"static attitude: sigma of shape {shape} expected") from None
    size = [np.linalg.norm(v, axis=-1) for v in vectors]
    present = np.isfinite(size[0]) & np.isfinite(size[1]) & (size[0] > 0.0) & (size[1] > 0.0)
    present &= np.isfinite(sigma) & (sigma > 0.0)
    # Absent vectors become one and the same direction of no weight.
    unit = [
        np.where(present[..., None], v, [0.0, 0.0, 1.0]) / np.where(present, s, 1.0)[..., None]
        for v, s in zip(vectors, size, strict=True)
    ]
    flag = np.where(np.sum(present, axis=-1) < 2, Flag.TOO_FEW_RAYS, Flag.OK).astype(np.uint8)
    return _Problem(unit[0], unit[1], np.where(present, sigma, 1.0), present, flag)


def _wahba_problem(body: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> _Problem:
    """Return the problem with its weak epochs flagged, on which no method is let loose."""
    given = _problem(body, reference, sigma_rad)
    weak = geometry_is_weak(given.body, given.sigma, given.present)
    weak |= geometry_is_weak(given.reference, given.sigma, given.present)
    return replace(given, flag=_flagged(given.flag, weak, Flag.WEAK_GEOMETRY))


def _flagged(flag: FlagArray, where: BoolArray, reason: Flag) -> FlagArray:
    return np.where((flag == Flag.OK) & where, reason, flag).astype(np.uint8)


def _optimal(problem: _Problem, quat: FloatArray) -> StaticAttitude:
    covariance = fisher_covariance(problem.body, problem.sigma, problem.present)
    return _finished(problem, quat, covariance)


def _finished(problem: _Problem, quat: FloatArray, covariance: FloatArray) -> StaticAttitude:
    """Normalise, sign and freeze; NaN where there is no answer."""
    flag = problem.flag
    ok = flag == Flag.OK
    size = np.linalg.norm(quat, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = quat / size * np.where(quat[..., 3:] < 0.0, -1.0, 1.0)
    unit = np.where(ok[..., None], unit, [0.0, 0.0, 0.0, 1.0])
    matrix = Rotation.from_quat(unit).as_matrix()
    predicted = np.einsum("...ji,...mj->...mi", matrix, problem.reference)
    misfit = np.sum((problem.body - predicted) ** 2, axis=-1) / problem.sigma**2
    loss = np.sum(np.where(problem.present, misfit, 0.0), axis=-1)
    return StaticAttitude(
        read_only(np.where(ok[..., None], unit, np.nan)),
        read_only(np.where(ok[..., None, None], covariance, np.nan)),
        read_only(np.where(ok, loss, np.nan)),
        np.sum(problem.present, axis=-1, dtype=np.int64),
        flag,
    )


def _orthogonal_frame(pair: FloatArray) -> FloatArray:
    """Columns v1, v1 × v2, v1 × (v1 × v2), unit, of pairs (..., 2, 3). *Source*: T (3.4)–(3.6)."""
    first = pair[..., 0, :]
    second = np.cross(first, pair[..., 1, :])
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def _quat_of_matrix(matrix: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_matrix(matrix).as_quat())
