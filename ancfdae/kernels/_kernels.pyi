"""Functions of `kernels.cpp`: arrays are double or complex, and converted where they are neither.

States are rows, (..., n_q), leading axes are instants. Relative node vectors Y = R q have the
shape (..., n, n_y, d), packed matrices (..., n, n_g).
"""

from collections.abc import Callable
from typing import Any, TypeAlias

from ancfdae.kernels import (
    Array,
    Block,
    CalledPlan,
    CoupledArrays,
    Factorise,
    FrontArrays,
    ListPlan,
    MatrixLayout,
    Plan,
)

def relative(block: Block, q: Array, /) -> Array:
    """Return Y = R q."""

def lifted(block: Block, F: Array, /) -> Array:
    """Return R^T F, the transpose of `relative`."""

def forces(block: Block, q: Array, v: Array | None, /) -> Array:
    """Return R^T of the internal forces (eqs. 13, 17); v is None without damping."""

def forces_along(block: Block, q: Array, v: Array | None, u: Array, z: Array | None, /) -> Array:
    """Return derivatives of `forces` along rows of u and z, directions of q and v.

    At one state for all rows, shape (1, n_q) or (n_q,), or at one for each.
    """

def force_totals(
    block: Block,
    q: Array,
    v: Array | None,
    A_b: Array,
    rest_b: Array,
    tau_b: Array,
    first: Array,
    pairs: Array,
    variables: Array,
    /,
) -> Array:
    """Return `forces` at the first row of q and v, then the total derivatives along the others.

    Row i + 1 belongs to design variable i. What variables change is said pair by pair of an element
    and a variable: element e has pairs[first[e]] to pairs[first[e + 1] - 1], sorted by variables.
    One below len(A_b) changes A by A_b, (n, n_g, n_g), and g_o and bending by rest_b,
    (n, n_g + 2), the further ones change tau by tau_b.
    """

def force_partials(
    block: Block,
    q: Array,
    v: Array | None,
    mu: Array | None,
    A_b: Array,
    rest_b: Array,
    tau_b: Array,
    first: Array,
    pairs: Array,
    variables: Array,
    n_b: int,
    /,
) -> Array:
    """Return design partials of `forces` at rows of q and v, (k, n_b, n_q); pairs as above.

    With covectors mu, one row for each instant, their products with mu are summed, (n_b,).
    """

def tangents(
    block: Block, q: Array, v: Array | None, damping: bool, index: Array, size: int, /
) -> Array:
    """Return derivatives of `forces` in q (eq. 19), or in v, as values that are summed.

    `index`, (n, (n_a d)^2), holds the place among `size` values of each entry of an element.
    """

def strain(g_o: Array | None, Y: Array, V: Array | None, tau: Array | None, /) -> Array:
    """Return g(Y) - g_o + tau g', what stresses are proportional to.

    Without g_o return Y V^T + V Y^T, packed: the derivative of Y Y^T at Y in direction V.
    """

def stressed(p: Array, Y: Array, /) -> Array:
    """Return W(p) Y, the gradient of p . g(Y)."""

class ConstraintPlan:
    """Constraints of joints; `constraint_plan.h` says what the indices are, in its order.

    Numbers are entries of L, coefficients (linear, products, offsets, inputs of formulas), and
    those that factors of time multiply. A formula has twelve lists. Factors have the shape
    (orders, k, n_parts) or (orders, 1, n_parts).
    """

    def __init__(
        self,
        indices: tuple[Array, ...],
        numbers: tuple[Array, Array, Array],
        d: int,
        n_q: int,
        n_values: int,
        n_curved: int,
        lists: tuple[OperationList, ...],
        /,
    ) -> None: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

def constraints(
    plan: ConstraintPlan, what: int, factors: Array, lam: Array | None, /, *motion: Array
) -> Array:
    """Return Phi, values of Phi_q or Phi_q^T lam, or their derivatives along the motion.

    `what` is a `Constraints`; states have a leading axis of k instants, or are those of one.
    """

def constraint_curvature(
    plan: ConstraintPlan, factors: Array, lam: Array, /, *motion: Array
) -> Array:
    """Return values of (Phi_q^T lam)_q, or its derivative along the motion with lam held."""

def constraint_gradient(
    plan: ConstraintPlan, factors: Array, lam: Array, /, *motion: Array
) -> tuple[Array, Array]:
    """Return partials of lam . Phi, or of its time derivative, in the numbers of the plan.

    In entries of L, (k, n_l), and in coefficients and their time derivatives, (k, orders, n_c).
    """

def constraint_totals(
    plan: ConstraintPlan,
    partials: tuple[Array, ...],
    factors: Array,
    factors_b: Array | None,
    lam: Array | None,
    lam_b: Array | None,
    motion: tuple[Array, ...],
    motion_b: tuple[Array, ...] | None,
    /,
) -> Array:
    """Return total design derivatives of Phi, or with lam of Phi_q^T lam, as rows, (k, n_b, n).

    Partials are (variable, number, first, part, entry, value), see `constraint_totals.h`;
    derivatives are rows, (k, n_b, n). Without those of the motion it is held.
    """

class LoadPlan:
    """A load as a list of operations; `load_plan.h` says what the indices are, in its order.

    Numbers are entries of L, constants, and own numbers of copies, (n_copies n_own,).
    """

    def __init__(
        self,
        indices: tuple[Array, ...],
        numbers: tuple[Array, Array, Array],
        n_q: int,
        n_values: int,
        n_signals: int,
        n_copies: int,
        /,
    ) -> None: ...
    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]: ...

class OperationTrace:
    """A list of operations in the making (`trace.h`); numbers are those of `trace.h`, as int32."""

    def __init__(self, n_inputs: int, /) -> None: ...
    def constant(self, real: float, imaginary: float, /) -> int:
        """Return the number of a constant."""

    def value(self, number: int, /) -> tuple[float, float]:
        """Return real and imaginary part of a constant."""

    def apply(self, operation: int, x: int, y: int, /) -> int:
        """Return the number of a result; y is x of operations of one number."""

    def power(self, x: int, exponent: float, /) -> int:
        """Return the number of a power: whole ones are products."""

    def call(self, inputs: Array, size: int, /) -> int:
        """Return the number of a call, behind which its results stand."""

    def along(
        self, outputs: Array, rates: Array, of_call: Callable[[int, Array], Array], /
    ) -> Array:
        """Return rates of outputs, (k, n_outputs), from rates of inputs, (k, n_inputs).

        `of_call` returns the rates of results of a call from those of its inputs, none if none
        moves.
        """

    def partials(self, output: int, /) -> Array:
        """Return partials of an output that follows from no call, (n_inputs,)."""

    def rows(self, outputs: Array, /) -> Array:
        """Return what outputs follow from, in order: number, operation, x and y, (k, 4)."""

    def inputs(self, outputs: Array, /) -> Array:
        """Return the inputs that outputs follow from, (k,)."""

    def placed(self, outputs: Array, inputs: Array, /) -> tuple[Array, ...]:
        """Return constants, operations, their numbers, outputs, calls, and which calls they are.

        These are the arguments of an `OperationList` of the inputs.
        """

    def sizes(self, /) -> tuple[int, int]:
        """Return how many operations and constants there are."""

class OperationList:
    """A list of operations on inputs and constants; `load_plan.h` has the codes of operations.

    Operation k is op[k] of numbers a[k] and b[k]. Numbers are inputs, constants, and results. What
    `functions` return, (k, size), of rows of inputs, follows `calls`.
    """

    def __init__(
        self,
        n_inputs: int,
        constants: Array,
        op: Array,
        a: Array,
        b: Array,
        outputs: Array,
        calls: Array,
        functions: tuple[Callable[[Array], Array], ...],
        /,
    ) -> None: ...

def list_values(operations: OperationList, *parts: Any) -> Array:
    """Return the outputs of a list, (k, n_outputs), or (n_outputs,) of one row for all.

    Inputs stand in parts, one behind the other: rows, (k, n), or one row for all, (n,).
    """

def index_1(
    lists: tuple[OperationList, ...],
    b: Array,
    scale: Array,
    projected: bool,
    t: Array,
    states: Array,
    /,
) -> Array | int:
    """Return (a, lam) above its design derivatives, (k, rows, n + m), or what prevents it.

    With `projected` return the states moved onto the constraints. `index_1.h` says what the lists
    are. States are (k, 2, rows, n), rows 1 or 1 + n_b; `scale`, (n + m,), makes the matrix free of
    units. A number is 1 where a value is not finite, and 2 where the matrix is singular.
    """

def plan_step(numbers: Array, stops: Array, t: float, /) -> tuple[int, float, float]:
    """Plan the step from time t by the numbers of a filter (`StepFilter` in `control.h`).

    Returns whether there is one (`PLANNED`), its size and its end.
    """

def judge_step(numbers: Array, n: int, t: float, h: float, error: float | None, /) -> int:
    """Judge a step of size h from instant n at time t by its error, None if it was not solved.

    Returns the index of the time point to go on from, `NEVER_SOLVED` or `NEVER_ACCURATE`.
    """

def explicit_march(
    equations: tuple[object, ...],
    tables: tuple[Array, Array, Array, Array],
    step: tuple[Array, Array, Array, Array],
    tolerances: tuple[float, Array, Array, int],
    times: Array,
    stop: float,
    count: int,
    kept: tuple[Array, Array, Array, Array],
    /,
) -> tuple[int, int, Array]:
    """Take at most `count` steps of DOP853, until one reaches the last time or the stop.

    `explicit.h` has the formulas. Return why the run ends, zero where it may go on, how many steps
    were taken, and the states at those of the ascending times that lie behind, (k, 2, rows, n).
    Equations are lists with b and the scale as above, or two functions of a time and a state,
    (2, rows, n), and the number of multipliers: one returns (a, lam), (rows, n + m), the other the
    state on the constraints, or each a number that says why not. Tables are the factors of stages,
    (16, 2, 18), those of errors, (2, 2, 12), nodes, (16,), and factors of the dense output,
    (4, 16). The arrays of a step are written to: rows, (18, rows n), states, (16, 2, rows, n),
    (a, lam), (16, rows, n + m), and t, end, h, error, the end of the step whose dense output is at
    hand, and the numbers of evaluations and projections. Tolerances: relative, absolute,
    (2, rows, n), the place of the system, (n,), and the length of its vectors. Of accepted steps
    are kept begin and end, (count, 2), states, (count, used, 2, rows, n), and multipliers,
    (count, used, rows, m), of
    the stages that the last array names.
    """

def explicit_terms(
    equations: tuple[object, ...],
    tables: tuple[Array, Array, Array, Array],
    step: tuple[Array, Array, Array, Array],
    /,
) -> Array | int:
    """Return terms of the dense output of the last step, (7, 2, rows, n), or what prevents it."""

def load_forces(plan: LoadPlan, factors: Array, q: Array, v: Array, /) -> Array:
    """Return Q of a load, (k, n_q); factors are its law and its signals, (k, 1 + n_signals)."""

def load_forces_along(
    plan: LoadPlan,
    factors: Array,
    rates: Array,
    q: Array,
    v: Array,
    dq: Array,
    dv: Array,
    /,
) -> Array:
    """Return its derivative along rows of dq, dv and rates of the signals, law held."""

def load_tangents(plan: LoadPlan, factors: Array, q: Array, v: Array, velocity: bool, /) -> Array:
    """Return values of Q_q, or with `velocity` of Q_v, (k, n_values)."""

def csr_rows(
    first: Array, columns: Array, values: Array, x: Array, transposed: int | None, /
) -> Array:
    """Return M x for rows of x, or M^T x with `transposed` columns of M, in sparse rows."""

def narrow_order(first_K: Array, columns_K: Array, first_B: Array, columns_B: Array, /) -> Array:
    """Return an order of coordinates and multipliers in which [K, B^T; B, 0] has a narrow band.

    The better of the one given and that of Cuthill and McKee, reversed; K has a symmetric pattern.
    """

def norm(*pairs: Array) -> float:
    """Return sqrt(sum(weights x^2)) of the real part, the sum over pairs (x, weights)."""

def band_factor(
    K: Array, B: Array, factors: Array, flat: Array, n: int, half: int, /
) -> tuple[Array, Array, float, int]:
    """Return LU factors in band form, (n, 3 half + 1), pivots, a scale, and LAPACK's info or -1.

    Values of K, of B and of B again are multiplied with factors, those of B with the size of the
    largest of K, too, which is the scale, and written to places `flat` of the band; -1 tells that
    a value is not finite.
    """

def band_solve(
    lu: Array,
    pivots: Array,
    half: int,
    order: Array,
    scale: Array,
    right: Array,
    transposed: bool,
    /,
) -> Array:
    """Return scale P^T (LU)^-1 P scale x for right sides x along the last axis.

    P numbers the rows: row i of the band is row order[i] of x.
    """

def ldl_factor(
    terms: tuple[tuple[float, Array], ...],
    B: Array,
    chosen: Array,
    places: Array,
    first: Array,
    signs: Array,
    /,
) -> tuple[Array, int]:
    """Return L D L^T in an envelope, and 0 or the number of the pivot without its sign.

    K is a sum of numbers times values. Its values `chosen` and all of B are written to `places`;
    column k of the envelope begins at first[k], with its diagonal. Nothing is exchanged.
    """

def ldl_solve(factors: Array, first: Array, order: Array, right: Array, /) -> Array:
    """Return P^T (L D L^T)^-1 P x for right sides x along the last axis; P as in `band_solve`."""

def eliminate(
    first: Array, columns: Array, /
) -> tuple[tuple[Array, Array, Array, Array, Array, Array, int, int], float]:
    """Return an order that keeps the fill of the given one, its fronts, and the multiplications.

    Entries of the symmetric matrix left of its diagonal stand row by row: where rows begin,
    (n + 1,), and columns. The fronts are the first seven of `FrontArrays`.
    """

def fronts_factor(
    terms: tuple[tuple[float, Array], ...],
    B: Array,
    chosen: Array,
    places: Array,
    fronts: FrontArrays,
    /,
) -> tuple[tuple[Array, Array, Array], int]:
    """Return the scaled matrix, its scale and factors, and the number of the pivot that fails.

    The chosen values of the sum and all of B go to places of the lower triangle. The number is 0
    where all pivots have their signs.
    """

def keeps_sides(
    q: Array, ends: Array, d: int, lengths: Array | None, least: Array | None, /
) -> bool:
    """Whether all states, rows of q, keep the sides of sections and tangents of the first one.

    `ends` are vectors of elements with their lengths and the least |r_x|^2, or of rigid bodies
    without. False proves nothing: signs of Bernstein's coefficients may differ.
    """

def fronts_signs(
    terms: tuple[tuple[float, Array], ...],
    B: Array,
    chosen: Array,
    places: Array,
    fronts: FrontArrays,
    counted: bool,
    /,
) -> tuple[int, float]:
    """Return by how many more pivots are negative than multipliers, and the growth of factors.

    The growth is the largest sum_k L_ik^2 |D_k|, relative to the diagonal of K and to rows of B
    of length one; infinite where a pivot vanishes, or has not its sign unless they are `counted`.
    """

def fronts_solve(
    factors: tuple[Array, Array, Array],
    fronts: FrontArrays,
    order: Array,
    right: Array,
    enough: float,
    /,
) -> tuple[Array, float]:
    """Return refined solutions for right sides, the last axis, and the largest residual.

    Residuals up to `enough`, or a few units of round-off, are not refined.
    The residual is relative to the largest entries of the scaled right side and solution.
    """

def finite(x: Array, /) -> bool:
    """Tell whether every entry is finite."""

#: Sizes, q, v and lam that steps arrived at, factors of joints (one row where nothing is driven)
#: and of loads there, matrices of the recurrence (`step_matrices`); of a system of one's own M,
#: f_q, f_v and Phi_q there; and where steps are small which, G and g (`ConstraintRow`).
Steps: TypeAlias = tuple[
    Array,
    Array,
    Array,
    Array,
    Array,
    Array,
    Array,
    tuple[Array, Array, Array | None, Array] | None,
    tuple[Array, Array, Array] | None,
]

#: Steps of Radau IIA for derivatives: sizes, (k,); M, Phi_q, f_q and f_v at stages, 3 k rows,
#: with one row of M where it is constant; f_q and f_v of completed stages; f_0,q; Phi'_q and
#: Phi''_q, None where these vanish; and places, A^-1 and A^-2 of the method, (21,).
ComputedStages: TypeAlias = tuple[
    Array,
    Array,
    Array,
    Array,
    Array | None,
    Array,
    Array | None,
    Array | None,
    tuple[Array, Array] | None,
    Array,
]

class Drivers:
    """What models of real and of complex numbers have."""

    def march(
        self,
        state: tuple[Array, Array, Array, Array, Array],
        motion: float,
        h: Array,
        of_joints: Array,
        of_loads: Array,
        seconds: float,
        rows: tuple[Array, Array, Array, Array],
        guess: tuple[Array, Array] | None,
        limits: tuple[float, float, int],
        /,
    ) -> tuple[int, int, float, Array, tuple[int, int, int], float, float]:
        """Take steps of sizes h from (q, v, a, lam, A), as many as can be taken in so many seconds.

        Factors of joints are (k, instants, n_parts): at the end of each step, at its beginning, at
        the three Gauss points, and their time derivatives there; two instants do where no step is
        small. Factors of loads are (k, 2, n_loads). A guess of a and lam replaces the one made
        here; limits are the tolerance, the factor by which corrections above round-off shrink at
        least, and the most iterations.

        Returns the number of steps taken, why it ends (`March`), the motion and a of the last
        state, counts of iterations, factorisations and steps that round-off disturbs, and of the
        last step the size of its last correction and the slowest rate of its corrections. The
        states after the steps, q, v, A and lam, are written to rows.
        """

    def march_controlled(
        self,
        state: tuple[Array, Array, Array, Array, Array],
        at: tuple[float, int, float, float],
        numbers: Array,
        stops: Array,
        tolerance: tuple[float, Array, Array, int],
        laws: tuple[Callable[[float, float, float], tuple[Array, Array, float]] | None, float],
        rows: tuple[Array, Array, Array, Array],
        beside: tuple[Array, Array, Array, Array],
        limits: tuple[float, int, float],
        /,
    ) -> tuple[int, int, int, tuple[int, int, int], float]:
        """Take steps under error control from (q, v, a, lam, A), until the rows are full.

        `at` holds the motion, as of `march`, the instant n, its time, and the size of the step that
        led there. The tolerance is (rtol, least sizes, place, numbers of a vector), and limits are
        those of Newton's method and seconds. Of (t, end, h) laws return the factors of joints and
        of loads in that step as rows of the tables of `march`, with the error of its turn; without
        laws a number is added to the times in a system of one's own. Rows are those of `march`, and
        a, ends, motions and filters stand beside them. Filter and rows are written.

        Returns the number of steps, why it ends (`March`), how many were rejected, counts as
        `march`, and the size of the last correction.
        """

    def rest(
        self,
        state: tuple[Array, ...],
        known: tuple[Array, Array | None, Array, Array],
        factors: tuple[Array, Array, Array],
        rules: Array,
        /,
    ) -> tuple[int, int, float, int]:
        """Solve for an equilibrium under part of the load, from q and lam, by Newton's method.

        The state (q, lam, q_s, lam_s) is written in place; where corrections have stopped shrinking
        the last one stands in (q_s, lam_s). Known are (q_0, anchor or None, r_0,
        Phi_0), factors those of constraints, of loads as they act, and of those that turn; of a
        system of one's own the time, the time, and whether loads turn. Returns
        why it ends (`Rest`), iterations, the size of the last correction, and whether K is surely
        positive definite.
        """

    def solve_stages(
        self,
        coupled: CoupledArrays,
        state: tuple[Array, Array, Array, Array],
        x: Array,
        lam: Array,
        of_joints: Array,
        of_loads: Array,
        tableau: Array,
        rules: Array,
        /,
    ) -> tuple[int, float, tuple[int, int, int]]:
        """Solve for the stages of a step of Radau IIA, from (q, v, a, lam) before it.

        Factors are those at the stages and at the start, (4,
        n_parts) and (4, n_loads). The tableau is c, A^-1 and A^-2, the rules are `StageRules` in
        `stages.h`. Returns how it ends, the size of the last correction, and counts of iterations,
        factorisations and whether round-off ended it.
        """

class Model(Drivers):
    """A system with its matrices, checked once, and room for its steps.

    The plan has real numbers (`real_part`). The rules are hht_alpha, Newton's tolerance, most
    iterations and the other numbers of `integrators/hht/step.py` in the order of `MarchRules` in
    `march.h`. A function to factorise is called where the layout has no place for a matrix.
    """

    def __init__(
        self, plan: Any, layout: MatrixLayout, rules: Array, factorise: Factorise | None, /
    ) -> None: ...
    def differentiate_steps(
        self, steps: Steps, right: Array, z: Array, states: Array, lam_b: Array, first: int, /
    ) -> tuple[int, int]:
        """Take steps of direct differentiation from a first one on.

        Returns the number of the next step, and why it ends as `march`. Rows of `right`, (k, n_b,
        n), are what is known of the right sides, and overwritten, as is z, (4, n_b, n_q); written
        are states, (k + 1, 3, n_b, n_q), but the row before the first step, and lam_b, (k, n_b,
        n_lam).
        """

    def pull_back_steps(
        self,
        steps: Steps,
        seeds: tuple[Array | None, Array | None, Array | None],
        on: Array,
        mu: Array,
        zeta: Array,
        on_defects: Array | None,
        count: int,
        /,
    ) -> tuple[int, int]:
        """Take the first steps, so many, of the transposed recurrence, the last of them first.

        Returns how many are left, and why it ends as `march`. Seeds are rows on q, v and lam, `on`,
        (6, n_q), is overwritten; written are rows of mu and zeta, and of covectors on the defects
        of q, v and A, (k, 3, n_q), if asked for.
        """

    def find_stages(
        self,
        of_joints: Array,
        of_loads: Array,
        q: Array,
        V: Array,
        A: Array,
        found: Array,
        first: int,
        /,
    ) -> tuple[int, int]:
        """Find a and lam, and v - V and sigma, of stages from a first one on.

        Returns the number of the next stage, and why it ends as `march`. Rows of q, V and rough
        accelerations A belong to stages, as do the factors of loads, (k, n_loads), and those of
        joints with one derivative, (2, k, n_parts), or any where nothing is driven. Written are
        rows of `found`, (k, 2, n).
        """

    def differentiate_stages(
        self,
        coupled: CoupledArrays,
        steps: ComputedStages,
        known: tuple[Array, Array, Array],
        states: Array,
        lam_b: Array,
        x_b: Array,
        first: int,
        /,
    ) -> tuple[int, int]:
        """Take steps of Radau IIA of direct differentiation from a first one on.

        Returns the number of the next step, and why it ends as `march`. Known are f_b with Phi_b of
        stages, and the negated right sides of v_b and of a_b without what the states give, (3 k,
        n_b, n) each, and overwritten. Written are states, (3 k + 1, 3, n_b, n_q), and lam_b,
        (3 k + 1, n_b, n_lam), but their rows before the first step, and x_b, (3 k, n_b, n_q).
        """

    def pull_back_stages(
        self,
        coupled: CoupledArrays,
        steps: ComputedStages,
        seeds: tuple[Array | None, Array | None, Array | None],
        on: Array,
        covectors: tuple[Array, ...],
        count: int,
        /,
    ) -> tuple[int, int]:
        """Take the first `count` steps of Radau IIA of the transposed recurrence, the last first.

        Returns how many are left, and why it ends as `march`. Seeds are rows on q, v and lam of
        stages; `on`, (2, n_q), is overwritten. Written are three covectors, (3 k, n) each: mu with
        zeta, and those on the right sides of v_b and of a_b; the last one only where there are
        seeds on lam.
        """

class ComplexModel(Drivers):
    """A system at complex numbers, with a model of their real parts that has its matrices."""

    def __init__(
        self, plan: Plan | ListPlan | CalledPlan, model: Model, rules: Array, /
    ) -> None: ...
