"""The physically consistent fit: bodies that have a density, friction that brakes, and the URDF where nothing is seen.

    minimize   |R theta - z|^2 / 2 + weight ( sum_b tr(P_b0^-1 P_b) - log det(P_b P_b0^-1) - 4  +  |u - u0|^2 / 2 ),
    P_b > 0 (Wensing, Kim, Slotine 2018, IEEE RA-L 3(1)),  u >= 0

with P_b the pseudo-inertias, P_b0 those of the URDF, in the log-det divergence of Lee, Wensing and Park 2020 (IEEE T-RO
36(2)), and u rotors and friction over their scales. In `P_b = C (1 + S) C'`, `P_b0 = C C'`, the divergence is
`tr S - log det(1 + S)`, about `|S|^2 / 2`. With that, the weight is chosen by leaving out blocks of the motion, in
closed form; the programme itself is convex and solved by Clarabel through cvxpy (extra `identify`).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import InputError, MmnnError
from ...signals import Array
from ...torque.prior import DOUBT
from ...torque.pseudo_inertia import BODY, pseudo_inertias, vector_of
from .equations import Bools, Equations, Unknowns
from .least_squares import WeightedFit

WEIGHTS = tuple(float(w) for w in np.logspace(-2, 5, 15))  # of the prior that are tried
BLOCKS = 5  # of the motion, each left out in turn
TIE = 1.002  # error over the least one up to which a larger weight is taken
THIN = 1e-3  # least eigenvalue of a prior body, relative to that of a ball of its mass
BALL = 0.05  # its radius of gyration [m]
LIGHT = 1e-3  # mass of a prior body without one [kg]
WIDE = 10.0  # standard deviation of friction, in its scale, that nothing has moved; of a body, relative, it is DOUBT
LOOSE = 1e-4  # of the prior that friction, constants and rotors that are there feel
BELIEVED = 0.05  # share of a body's doubt that the motion has to take away before the body leaves the URDF
CAREFUL: tuple[dict[str, Any], ...] = (  # settings of the solver, one after the other, where the usual ones fail
    {"max_step_fraction": 0.9, "static_regularization_constant": 1e-7},
    {"max_step_fraction": 0.8, "static_regularization_constant": 1e-6, "equilibrate_max_iter": 50},
)
CALM = 1e4  # of |z|^2, above which the programme is solved in smaller numbers
ROTOR = 0.03  # share of a joint's force that its rotor may need at least, before the motion says so
ROOT2 = np.sqrt(2.0)
PLACES = tuple((i, j) for i in range(4) for j in range(i, 4))


class SolverError(MmnnError):
    """The programme has no solution that can be used."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Coordinates x of the parameters in which the prior is the unit ball around `centre`: `theta = centre + B x`.

    Attributes:
        unknowns: What is fitted.
        centre: (k,) the URDF's parameters, thin bodies made a little thicker.
        B: (k, m) columns: ten of every body, one of every other parameter.
        bodies: Number of bodies.
        positive: (m - 10 bodies,) least value of every other coordinate; -inf where it has none.
        strength: (m,) how much of the prior a coordinate feels: 1, or next to none of constants.
    """

    unknowns: Unknowns
    centre: Array
    B: Array
    bodies: int
    positive: Array
    strength: Array

    @classmethod
    def of(cls, unknowns: Unknowns, equations: Equations) -> Prior:
        """The prior of a robot; friction is measured by the efforts and speeds of a motion."""
        regressor = unknowns.regressor
        centre, k, first = unknowns.prior.copy(), unknowns.size, unknowns.regressor.inertial
        bodies = first // BODY
        B = np.zeros((k, k))
        for b, P in enumerate(pseudo_inertias(centre[:first])):
            thick = thickened(P)
            centre[BODY * b : BODY * (b + 1)] = vector_of(thick)
            fill_body(B, b, thick)
        force, speed, rotor = sizes(unknowns, equations)
        scale = np.ones(k)
        for kind, size in (("rotor", rotor), ("viscous", force / speed), ("coulomb", force), ("stribeck", force)):
            places = [i for i in unknowns.columns(kind) if unknowns.labels[i].rpartition(".")[0] in regressor.joints]
            scale[places] = size[: len(places)]
        offsets = unknowns.columns("offset")
        scale[offsets] = np.maximum(np.sqrt((equations.y**2).mean(axis=0)), 1e-9)
        for i in unknowns.columns("coulomb"):  # of a base that scrubs
            name = unknowns.labels[i].rpartition(".")[0]
            if name in unknowns.names and name not in regressor.joints:
                scale[i] = scale[unknowns.labels.index(f"{name}.offset")]
        B[np.arange(first, k), np.arange(first, k)] = scale[first:]
        B[unknowns.of_base] = 0.0
        strength = np.ones(k)
        strength[unknowns.columns("viscous", "coulomb", "stribeck", "offset")] = LOOSE
        positive = -centre[first:] / scale[first:]
        positive[offsets - first] = -np.inf
        return cls(unknowns, centre, B, bodies, positive, strength)

    def around(self, theta: Array) -> Array:
        """B (k, m) of bodies as they are in theta (k,), not in the prior."""
        B = self.B.copy()
        for b, P in enumerate(pseudo_inertias(theta[: BODY * self.bodies])):
            fill_body(B, b, P)
        return B

    def of_any_size(self, rotors: NDArray[np.int64]) -> Prior:
        """The prior where some rotors are there, of any size: links would take a part of them otherwise."""
        strength = self.strength.copy()
        strength[rotors] = LOOSE
        return replace(self, strength=strength)

    @cached_property
    def root(self) -> Array:
        """Square roots of the strengths, (m,)."""
        return np.sqrt(self.strength)

    def theta(self, x: Array) -> Array:
        """Parameters of coordinates, (k,)."""
        return np.asarray(self.centre + self.B @ x)


def fill_body(B: Array, b: int, P: Array) -> None:
    """Columns of body b: changes of its pseudo-inertia P, each of the size of P itself, in place."""
    C = np.linalg.cholesky(P)
    for c, (i, j) in enumerate(PLACES):
        S = np.zeros((4, 4))
        S[i, j] = S[j, i] = 1.0 if i == j else 1 / ROOT2
        B[BODY * b : BODY * (b + 1), BODY * b + c] = vector_of(C @ S @ C.T)


def thickened(P: Array) -> Array:
    """A pseudo-inertia with at least a little mass and extent, so that it has a density."""
    mass = max(P[3, 3], LIGHT)
    size = BALL**2 * mass
    ball = np.diag([size, size, size, mass])
    if P[3, 3] > 0:
        at = P[:3, 3] / P[3, 3]
        shift = np.eye(4)
        shift[:3, 3] = at
        ball = shift @ ball @ shift.T
    root = np.linalg.cholesky(ball)
    inward = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inward @ P @ inward.T)
    if values.min() >= THIN:
        return P
    half = root @ vectors
    return np.asarray((half * np.maximum(values, THIN)) @ half.T)


def sizes(unknowns: Unknowns, equations: Equations) -> tuple[Array, Array, Array]:
    """Typical force, speed and rotor inertia of every joint of the regressor, (joints,) each.

    A rotor is believed to be as large as the inertia that its joint feels, or as what takes `ROTOR` of the force for
    the motion's accelerations: that of a geared wrist is thousands of times its last link.
    """
    rows = list(unknowns.rows)
    part = np.abs(unknowns.joint_rows[:, rows])
    none = np.where(part.sum(axis=1) > 0, 0.0, 1.0)
    spread = np.array(
        [y[use].std() if use.any() else 0.0 for y, use in zip(equations.y.T, equations.use.T, strict=True)]
    )
    force = part @ spread / np.maximum((part**2).sum(axis=1), 1e-12) + none
    joint_speed = np.sqrt(((equations.speed @ unknowns.joint_rows[:, rows].T) ** 2).mean(axis=0))
    M = np.abs(mass_matrix(unknowns))
    inertia = (part @ np.diag(M)[rows]) / np.maximum((part**2).sum(axis=1), 1e-12) + none
    squares = (equations.Y[:, :, unknowns.columns("rotor")] ** 2).sum(axis=1).mean(axis=0)
    acceleration = np.sqrt(squares / np.maximum((part**2).sum(axis=1), 1e-12))
    rotor = np.maximum(inertia, np.where(none > 0, 0.0, ROTOR * force / np.maximum(acceleration, 1e-3)))
    return np.maximum(force, 1e-9), np.maximum(joint_speed, 1e-3), np.maximum(rotor, 1e-9)


def mass_matrix(unknowns: Unknowns) -> Array:
    """M of the URDF at rest, (p, p)."""
    regressor, p = unknowns.regressor, len(unknowns.robot.velocity_names)
    theta = unknowns.prior[: regressor.size]
    q = np.tile(unknowns.robot.rest[unknowns.robot.arm_index], (p + 1, 1))
    forces = regressor.along(q, np.zeros((p + 1, p)), np.vstack((np.zeros(p), np.eye(p)))) @ theta
    return np.asarray(forces[1:] - forces[0])


# -- the weight of the prior -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Blocks:
    """Normal equations of the blocks of a motion, in the prior's coordinates, row by row.

    Attributes:
        A: (blocks, r, m, m) `X' X` of the equations that count.
        b: (blocks, r, m) `X' (y - Y centre)`.
        c: (blocks, r) `|y - Y centre|^2`.
        square: (blocks, r) `|y|^2`.
    """

    A: Array
    b: Array
    c: Array
    square: Array

    @classmethod
    def of(cls, equations: Equations, prior: Prior, weights: Array | None = None, count: int = BLOCKS) -> Blocks:
        """Blocks of equal length, one after the other; with weights (M, r) of the equations, by default 1 or 0."""
        weights = equations.use.astype(float) if weights is None else weights
        m, r = prior.B.shape[1], equations.y.shape[1]
        A, b = np.zeros((count, r, m, m)), np.zeros((count, r, m))
        c, square = np.zeros((count, r)), np.zeros((count, r))
        block = np.arange(len(equations)) * count // len(equations)
        for i in range(r):
            for n in range(count):
                use = (block == n) & (weights[:, i] > 0)
                root = np.sqrt(weights[use, i])
                Y, y = equations.Y[use, i] * root[:, None], equations.y[use, i] * root
                X, e = Y @ prior.B, y - Y @ prior.centre
                A[n, i], b[n, i], c[n, i], square[n, i] = X.T @ X, X.T @ e, e @ e, y @ y
        return cls(A, b, c, square)

    def left_out(self, rows: Bools, deviation: Array, strength: Array) -> Array:
        """Squared errors of every row on blocks that the ridge fit to the other blocks has not seen, (weights, r).

        With the strengths D, `(A + w D)^-1 b` is `D^-1/2 V (L + w)^-1 V' D^-1/2 b` for all w, V L V' = D^-1/2 A D^-1/2.
        """
        scale, root = np.where(rows, 1 / deviation**2, 0.0), np.sqrt(strength)
        errors = np.zeros((len(WEIGHTS), len(rows)))
        A, b = np.tensordot(scale, self.A, (0, 1)), np.tensordot(scale, self.b, (0, 1))
        for n in range(len(A)):
            values, vectors = np.linalg.eigh((A.sum(axis=0) - A[n]) / np.outer(root, root))
            part = vectors.T @ ((b.sum(axis=0) - b[n]) / root)
            x = (vectors @ (part[:, None] / (np.maximum(values, 0.0)[:, None] + np.array(WEIGHTS)))) / root[:, None]
            for i in range(len(rows)):
                errors[:, i] += (x * (self.A[n, i] @ x)).sum(axis=0) - 2 * self.b[n, i] @ x + self.c[n, i]
        return np.maximum(errors, 0.0)

    def chosen(self, rows: Bools, deviation: Array, strength: Array) -> tuple[float, Array]:
        """The largest weight among the best, and its squared errors left out, (r,)."""
        every = self.left_out(rows, deviation, strength)
        score = every @ np.where(rows, 1 / deviation**2, 0.0)
        best = int(np.flatnonzero(score <= TIE**2 * score.min())[-1])
        return WEIGHTS[best], every[best]


# -- the programme -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Consistent:
    """A fit that is physically possible.

    Attributes:
        theta: (k,) parameters.
        covariance: (k, k) of them: what the motion and the prior leave open.
        weight: Of the prior.
        known: (k,) share of a parameter's prior variance that the motion took away, 0 to 1.
    """

    theta: Array
    covariance: Array
    weight: float
    known: Array


def consistent_fit(
    R: Array, z: Array, prior: Prior, weight: float, inflation: float = 1.0, allowed: Bools | None = None
) -> Consistent:
    """Solve the programme.

    Args:
        R: (m, m) and
        z: (m,) the weighted equations, from `compressed`.
        prior: Of the robot.
        weight: Of the prior.
        inflation: How many equations say as much as one, see `least_squares.WeightedFit`.
        allowed: (m,) coordinates that may leave the URDF; by default all.

    Raises:
        SolverError: The solver found no solution.
        InputError: cvxpy or Clarabel are not installed.
    """
    moved = np.linalg.norm(R, axis=0) > 1e-12 * np.linalg.norm(R)
    _, known = doubt(R, prior, prior.B, inflation)
    for b in range(prior.bodies):
        at = slice(BODY * b, BODY * (b + 1))
        moved[at] &= known[at].max() > BELIEVED
    moved &= True if allowed is None else allowed
    theta = prior.theta(minimised(R, z, prior, weight, moved))
    covariance, known = doubt(R, prior, prior.around(theta), inflation)
    still = np.repeat([not moved[BODY * b : BODY * (b + 1)].any() for b in range(prior.bodies)], BODY)
    theta[: len(still)][still] = prior.unknowns.prior[: len(still)][still]  # as the file has them, thin ones too
    return Consistent(theta, covariance, weight, known)


def doubt(R: Array, prior: Prior, B: Array, inflation: float) -> tuple[Array, Array]:
    """Covariance (k, k) of the parameters, and share of every one's prior variance that the motion took away, (k,).

    The prior is `DOUBT` and `WIDE`, not the programme's: a weight that suits the prediction says nothing of the truth.
    """
    change = np.linalg.lstsq(prior.B, B, rcond=None)[0]
    before = np.where(prior.strength < 1, WIDE, DOUBT)
    root = np.linalg.qr(np.vstack((R @ change / np.sqrt(inflation), np.diag(1 / before))), mode="r")
    half = scipy.linalg.solve_triangular(root, B.T, trans="T")  # squared, an exact log's numbers would lose the prior
    covariance = half.T @ half
    spread = (B**2) @ before**2
    known = 1 - np.diag(covariance) / np.where(spread > 0, spread, 1.0)
    return covariance, np.clip(np.where(spread > 0, known, 0.0), 0.0, 1.0)


def compressed(equations: Equations, prior: Prior, rows: Bools, fit: WeightedFit) -> tuple[Array, Array]:
    """R (m, m) and z (m,) with the same squared errors as the equations with a fit's weights, up to a constant."""
    parts = []
    for i in np.flatnonzero(rows):
        use = fit.weights[:, i] > 0
        Y, y = equations.Y[use, i], equations.y[use, i]
        scale = np.sqrt(fit.weights[use, i]) / fit.deviation[i]
        parts.append(np.column_stack((Y @ prior.B, y - Y @ prior.centre)) * scale[:, None])
    full = np.asarray(np.linalg.qr(np.vstack(parts), mode="r"))
    return full[:, :-1], full[:, -1]


def minimised(R: Array, z: Array, prior: Prior, weight: float, moved: Bools) -> Array:
    """Coordinates x (m,) of the least objective; bodies and parameters that nothing moves stay at the prior.

    Raises:
        SolverError: Clarabel's status is not optimal.
        InputError: cvxpy or Clarabel are not installed.
    """
    try:
        import cvxpy as cp
    except ImportError as error:
        raise InputError(
            "the consistent fit needs cvxpy", why=f"no {error.name}", fix="pip install 'mmnn_pin[identify]'"
        ) from None
    first, m = BODY * prior.bodies, len(prior.strength)
    bodies = [b for b in range(prior.bodies) if moved[BODY * b : BODY * (b + 1)].any()]
    others = first + np.flatnonzero(moved[first:])
    variables = [cp.Variable(BODY) for _ in bodies]
    u = cp.Variable(len(others))
    places = [np.arange(BODY * b, BODY * (b + 1)) for b in bodies]
    left: Any = R[:, others] @ u - z
    distance: Any = 0.5 * cp.sum_squares(cp.multiply(prior.root[others], u))
    for at, s in zip(places, variables, strict=True):
        left = left + R[:, at] @ s
        S = symmetric(cp, s)
        distance = distance + cp.trace(S) - cp.log_det(np.eye(4) + S)
    least = prior.positive[others - first]
    bounded = np.flatnonzero(np.isfinite(least))
    scale = CALM / max(float(z @ z), CALM)  # an exact log has residuals of no size, and numbers no solver likes
    cost = 0.5 * cp.sum_squares(np.sqrt(scale) * left) + scale * weight * distance
    problem = cp.Problem(cp.Minimize(cost), [u[bounded] >= least[bounded]])
    for careful in ({}, *CAREFUL):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # cvxpy's, of an inaccurate solution: the next settings follow
                problem.solve(solver=cp.CLARABEL, **careful)
            status = str(problem.status)
        except cp.error.SolverError as failure:
            status = " ".join(str(failure).split())
        if status == "optimal":
            break
    if status not in ("optimal", "optimal_inaccurate") or u.value is None:
        raise SolverError(
            f"no physically consistent fit: the solver says {status}; look at the signals, or raise --cutoff"
        )
    x = np.zeros(m)
    for at, s in zip(places, variables, strict=True):
        x[at] = s.value
    x[others] = np.maximum(u.value, np.where(np.isfinite(least), least, -np.inf))
    return x


def symmetric(cp: Any, s: Any) -> Any:
    """A symmetric matrix of ten coordinates, as an expression."""
    rows: list[list[Any]] = [[0] * 4 for _ in range(4)]
    for c, (i, j) in enumerate(PLACES):
        rows[i][j] = rows[j][i] = s[c] if i == j else s[c] / ROOT2
    return cp.bmat(rows)


def positive_bodies(theta: Array, inertial: int) -> Iterator[float]:
    """Smallest eigenvalue of every body's pseudo-inertia."""
    for P in pseudo_inertias(theta[:inertial]):
        yield float(np.linalg.eigvalsh(P)[0])
