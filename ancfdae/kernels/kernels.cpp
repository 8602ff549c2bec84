/* Inner loops of the package: element forces and tangents, sparse products, banded solutions.
 *
 * `core.h` computes, `*_calls.h` check what Python gives, `binding.h` converts it, and here all that
 * Python sees is declared: the names of arguments and what a function returns. Their types are those
 * of the C++ function; the build writes both to `_kernels.pyi`.
 */

#define PY_SSIZE_T_CLEAN
/* The stable ABI: one build serves every Python from 3.11 on. */
#define Py_LIMITED_API 0x030A0000
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define NPY_TARGET_VERSION NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>

#include <algorithm>
#include <array>
#include <deque>
#include <initializer_list>
#include <limits>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "core.h"

namespace
{

#include "binding.h"

#include "element_calls.h"
#include "list_calls.h"
#include "plan_calls.h"
#include "matrix_calls.h"
#include "model_calls.h"
#include "acceleration_calls.h"

/* Functions and methods of numbers of one kind, of real or complex ones, and of matrices and right
 * sides of real or complex ones. */
template <auto f, auto g> using Scalars = Either<Bound<f>, Bound<g>>;
template <auto f, auto g, auto h> using Solver = Either<Scalars<f, g>, Bound<h>, 2>;

#define FUNCTION(f, ...) declared<Bound<&f>>(__VA_ARGS__)
#define FUNCTION_2(f, ...) declared<Scalars<&f<double>, &f<Complex>>>(__VA_ARGS__)
#define METHOD(f, ...) declared<OfSelf<Bound<&f>>>(__VA_ARGS__)
#define METHOD_2(f, ...) declared<OfSelf<Scalars<&f<double>, &f<Complex>>>>(__VA_ARGS__)
#define METHOD_3(f, ...)                                                                           \
    declared<OfSelf<Solver<&f<double, double>, &f<double, Complex>, &f<Complex, Complex>>>>(       \
        __VA_ARGS__)

void functions_added(PyObject *module)
{
    static PyMethodDef functions[] = {
        FUNCTION_2(py_strain, "strain", "g_o, Y, V, tau",
            "Return g(Y) - g_o + tau g', what stresses are proportional to, (..., n, n_g).\n\n"
            "Without g_o return Y V^T + V Y^T, packed: the derivative of Y Y^T at Y, shape\n"
            "(..., n, n_y, d), in direction V."),
        FUNCTION_2(py_stressed, "stressed", "p, Y", "Return W(p) Y, the gradient of p . g(Y)."),
        FUNCTION(py_norm, "norm", "*pairs",
            "Return sqrt(sum(weights x^2)) of the real part, the sum over pairs (x, weights)."),
        FUNCTION(py_finite, "finite", "x", "Tell whether every entry is finite."),
        FUNCTION_2(py_csr_rows, "csr_rows", "first, columns, values, x, transposed",
            "Return M x for rows of x, or M^T x with `transposed` columns of M, in sparse rows."),
        FUNCTION(py_narrow_order, "narrow_order", "first_K, columns_K, first_B, columns_B",
            "Return an order of coordinates and multipliers for a narrow [K, B^T; B, 0].\n\n"
            "The better of the one given and that of Cuthill and McKee, reversed; K has a\n"
            "symmetric pattern."),
        FUNCTION(py_eliminate, "eliminate", "first, columns",
            "Return an order that keeps the fill of the given one, its fronts, and the\n"
            "multiplications.\n\n"
            "Entries of the symmetric matrix left of its diagonal stand row by row: where rows\n"
            "begin, (n + 1,), and columns. The fronts are the first seven arguments of\n"
            "`FrontPlan`."),
        FUNCTION(py_keeps_sides, "keeps_sides", "q, ends, d, lengths, least",
            "Whether all states, rows of q, keep the sides of sections and tangents of the\n"
            "first.\n\n"
            "`ends` are vectors of elements with their lengths and the least |r_x|^2, or of\n"
            "rigid bodies without. False proves nothing: signs of Bernstein's coefficients may\n"
            "differ."),
        FUNCTION(py_plan_step, "plan_step", "numbers, stops, t",
            "Plan the step from time t by the numbers of a filter (`StepFilter` in `control.h`).\n\n"
            "Returns whether there is one (`PLANNED`), its size and its end."),
        FUNCTION(py_judge_step, "judge_step", "numbers, n, t, h, error",
            "Judge a step of size h from instant n at time t by its error, None if not solved.\n\n"
            "Returns the index of the time point to go on from, `NEVER_SOLVED` or `NEVER_ACCURATE`."),
        {nullptr, nullptr, 0, nullptr},
    };
    if (PyModule_AddFunctions(module, functions) < 0)
        throw Failed();
}

void elements_added(PyObject *module)
{
    type_added<Elements>(
        module, "A, g_o, bending, tau, vectors, d, n_q",
        "Elements of one kind: their law, (n or 1, ...), and their node vectors, (n, n_a).\n\n"
        "`bending`, (n or 1, 2), holds E I and the length of cables, zeros of beams. Vector k\n"
        "has the coordinates d k to d k + d - 1 of n_q; tau, (n,), is None without damping.\n"
        "States are rows, (..., n_q), relative node vectors Y = R q have the shape (..., n,\n"
        "n_y, d).",
        {
        METHOD_2(py_relative, "relative", "q", "Return Y = R q."),
        METHOD_2(py_lifted, "lifted", "F", "Return R^T F, the transpose of `relative`."),
        METHOD_2(py_forces, "forces", "q, v",
            "Return R^T of the internal forces (eqs. 13, 17); v is None without damping."),
        METHOD_2(py_forces_along, "forces_along", "q, v, u, z",
            "Return derivatives of `forces` along rows of u and z, directions of q and v.\n\n"
            "At one state for all rows, shape (1, n_q) or (n_q,), or at one for each."),
        METHOD_2(py_force_totals, "force_totals", "q, v, law_b",
            "Return `forces` at the first row of q and v, then total derivatives along others.\n\n"
            "Row i + 1 belongs to design variable i. What these change is (A_b, rest_b, tau_b,\n"
            "first, pairs, variables), pair by pair of an element and a variable: element e has\n"
            "pairs[first[e]] to pairs[first[e + 1] - 1], sorted by variables. One below\n"
            "len(A_b) changes A by A_b, (n, n_g, n_g), and g_o and bending by rest_b, (n, n_g +\n"
            "2), the further ones change tau by tau_b."),
        METHOD_2(py_force_partials, "force_partials", "q, v, mu, law_b, n_b",
            "Return design partials of `forces` at rows of q and v, (k, n_b, n_q).\n\n"
            "With covectors mu, one row for each instant, their products with mu are summed,\n"
            "(n_b,)."),
        METHOD_2(py_tangents, "tangents", "q, v, damping, index, size",
            "Return derivatives of `forces` in q (eq. 19), or in v, as values that are summed.\n\n"
            "`index`, (n, (n_a d)^2), holds the place among `size` values of each entry of an\n"
            "element."),
        });
}

const char *const ACCELERATIONS =
    "Return (a, lam) above its design derivatives, (k, rows, n + m), or what prevents it.\n\n"
    "With `projected` return the states moved onto the constraints. States are (k, 2, rows,\n"
    "n). A number is 1 where a value is not finite, and 2 where the matrix is singular.";
const char *const FACTORISATIONS = "Return how many matrices were factorised since the last call.";

void lists_added(PyObject *module)
{
    type_added<OperationList>(
        module, "n_inputs, constants, op, a, b, outputs, calls, functions",
        "A list of operations; `load_plan.h` says what the indices are.\n\n"
        "Functions take rows of inputs, (k, n), and return rows of outputs.",
        {METHOD_2(py_values, "values", "*parts",
            "Return the outputs, (k, n_outputs), or (n_outputs,) of one row for all.\n\n"
            "Inputs stand in parts, one behind the other: rows, (k, n), or one row for all,\n"
            "(n,).")});
    type_added<OperationTrace>(
        module, "n_inputs",
        "A list of operations in the making; numbers are those of `trace.h`.",
        {
        METHOD(py_constant, "constant", "real, imaginary", "Return the number of a constant."),
        METHOD(py_value, "value", "number", "Return real and imaginary part of a constant."),
        METHOD(py_apply, "apply", "operation, x, y",
            "Return the number of a result; y is x of operations of one number."),
        METHOD(py_power, "power", "x, exponent",
            "Return the number of a power: whole ones are products."),
        METHOD(py_call, "call", "inputs, size",
            "Call the next function; its results stand behind the number that is returned."),
        METHOD(py_along, "along", "outputs, rates, of_call",
            "Return rates of outputs along rows of rates of all inputs, a row for each.\n\n"
            "`of_call` takes the index of a call and the rates of its inputs, and returns the\n"
            "rates of its results, or nothing where none moves."),
        METHOD(py_partials, "partials", "output",
            "Return the partials of an output by all inputs."),
        METHOD(py_rows, "rows", "outputs",
            "Return the operations that outputs follow from: number, operation, its two\n"
            "numbers."),
        METHOD(py_inputs, "inputs", "outputs", "Return the inputs that outputs follow from."),
        METHOD(py_placed, "placed", "outputs, inputs",
            "Return what an `OperationList` of some inputs is made of.\n\n"
            "Constants, operations with both their numbers, outputs, calls, and which functions\n"
            "these call. Inputs, constants and results are counted in this order; what outputs\n"
            "do not follow from is left out."),
        METHOD(py_sizes, "sizes", "", "Return how many operations and constants there are."),
        });
    type_added<ListAccelerations>(
        module, "lists, b, scale",
        "Accelerations of a system of lists (`index_1.h`); with six lists of design\n"
        "derivatives, too.\n\n"
        "The scale, (n + m,), makes the matrix free of units.",
        {METHOD(py_accelerations<ListAccelerations>, "at", "projected, t, states", ACCELERATIONS),
         METHOD(py_factorisations<ListAccelerations>, "factorisations", "", FACTORISATIONS)});
    type_added<SceneAccelerations>(
        module, "model, design, factors",
        "Accelerations of a scene (`scene_accelerations.h`), with a design its derivatives, too.\n\n"
        "The design is a `DesignPlan` or None. Factors is a function of times, (k,), or its\n"
        "result for all times: those of joints with two derivatives, (3, k, n_parts), and of\n"
        "loads, (k, n_loads), and their partials, (n_b, 3, k, n_parts) and (n_b, k, n_loads), or\n"
        "None.",
        {METHOD(py_accelerations<SceneAccelerations>, "at", "projected, t, states", ACCELERATIONS),
         METHOD(py_factorisations<SceneAccelerations>, "factorisations", "", FACTORISATIONS)});
    type_added<ExplicitRun>(
        module, "equations, tables, step",
        "Steps of DOP853 from a state (`explicit.h`).\n\n"
        "Equations are `ListAccelerations`, `SceneAccelerations`, or two functions of a time and\n"
        "a state, (2, rows, n): one returns (a, lam), (rows, n + m), the other the state on the constraints, or\n"
        "each a number that says why not. Tables are the factors of stages, (16, 2, 18), those\n"
        "of errors, (2, 2, 12), nodes, (16,), and factors of the dense output, (4, 16). The\n"
        "arrays of a step are written to: rows, (18, rows n), states, (16, 2, rows, n), (a,\n"
        "lam), (16, rows, n + m), and `StepControl`.",
        {METHOD(py_explicit, "march", "tolerances, times, stop, count, kept",
            "Take at most `count` steps, until one reaches the last time or the stop.\n\n"
            "Return why the run ends, zero where it may go on, how many steps were taken, and\n"
            "the states at those of the ascending times that lie behind, (k, 2, rows, n).\n"
            "Tolerances: relative, absolute, (2, rows, n), the place of the system, (n,), and\n"
            "the length of its vectors. Of accepted steps are kept begin and end, (count, 2),\n"
            "states, (count, used, 2, rows, n), and multipliers, (count, used, rows, m), of the\n"
            "stages that the last array names."),
        METHOD(py_terms, "terms", "",
            "Return terms of the dense output of the last step, (7, 2, rows, n), or what\n"
            "prevents it.")});
}

void plans_added(PyObject *module)
{
    type_added<ConstraintPlan>(
        module, "indices, numbers, d, n_q, n_values, n_curved, lists",
        "Constraints of joints; `constraint_plan.h` says what the indices are, in its order.\n\n"
        "Numbers are entries of L, coefficients (linear, products, offsets, inputs of\n"
        "formulas), and those that factors of time multiply. A formula has twelve lists.\n"
        "Factors have the shape (orders, k, n_parts) or (orders, 1, n_parts); states a leading\n"
        "axis of k instants, or none.",
        {
        METHOD_2(py_evaluate, "evaluate", "what, factors, lam, *motion",
            "Return Phi (RATE), values of Phi_q (VALUES) or Phi_q^T lam (FORCE), or derivatives\n"
            "of these along the motion."),
        METHOD_2(py_curvature, "curvature", "factors, lam, *motion",
            "Return values of (Phi_q^T lam)_q, or its derivative along the motion, lam held."),
        METHOD_2(py_gradient, "gradient", "factors, lam, *motion",
            "Return partials of lam . Phi, or of its time derivative, in the plan's numbers.\n\n"
            "In entries of L, (k, n_l), and in coefficients and their time derivatives, (k,\n"
            "orders, n_c)."),
        METHOD(py_totals, "totals", "partials, factors, factors_b, lam, lam_b, motion, motion_b",
            "Return total design derivatives of Phi, or with lam of Phi_q^T lam, (k, n_b, n).\n\n"
            "Partials are (variable, number, first, part, entry, value), see\n"
            "`constraint_totals.h`; derivatives are rows, (k, n_b, n). Without those of the\n"
            "motion it is held."),
        });
    type_added<LoadPlan>(
        module, "indices, numbers, n_q, n_values, n_signals, n_copies",
        "A load as a list of operations; `load_plan.h` says what the indices are, in its order.\n\n"
        "Numbers are entries of L, constants, and own numbers of copies, (n_copies n_own,).\n"
        "Factors are its law and its signals, (k, 1 + n_signals).",
        {
        METHOD_2(py_load, "forces", "factors, q, v", "Return Q, (k, n_q)."),
        METHOD_2(py_load_along, "forces_along", "factors, rates, q, v, dq, dv",
            "Return the derivative of Q along rows of dq, dv and rates of the signals, law\n"
            "held."),
        METHOD_2(py_load_tangents, "tangents", "factors, q, v, velocity",
            "Return values of Q_q, or with `velocity` of Q_v, (k, n_values)."),
        });
}

void matrices_added(PyObject *module)
{
    type_added<Band>(
        module, "half, flat, factors, order",
        "A band of a half width: places `flat` and factors of values of K, of B and of B again.\n\n"
        "P numbers the rows: row i of the band is row order[i] of a right side.",
        {METHOD_2(py_band_factor, "factor", "K, B",
            "Return LU factors in band form, (n, 3 half + 1), pivots, a scale, and LAPACK's\n"
            "info.\n\n"
            "Values of B are multiplied with the size of the largest of K, which is the scale;\n"
            "an info of -1 tells that a value is not finite."),
        METHOD_3(py_band_solve, "solve", "lu, pivots, scale, right, transposed",
            "Return scale P^T (LU)^-1 P scale x for right sides x along the last axis.")});
    type_added<Envelope>(
        module, "first, chosen, places, signs, order",
        "The lower triangle of a symmetric matrix, of which column k begins at first[k].\n\n"
        "Values `chosen` of K and all of B have places; pivots have signs.",
        {METHOD_2(py_ldl_factor, "factor", "terms, B",
            "Return L D L^T, and 0 or the number of the pivot without its sign.\n\n"
            "K is a sum of numbers times values. Nothing is exchanged."),
        METHOD(py_envelope_size, "size", "", "Return how many numbers it holds."),
        METHOD_3(py_ldl_solve, "solve", "factors, right",
            "Return P^T (L D L^T)^-1 P x for right sides x along the last axis.")});
    type_added<FrontPlan>(
        module, "begin, row_at, rows, factor_at, children, stack, most, column_at, column_rows, signs, order, chosen, places",
        "Fronts of a sparse elimination, whose indices are numbers in the order of elimination.\n\n"
        "The first pivot of each front, and n; where its row numbers begin; row numbers; where\n"
        "its factors begin; how many waiting updates it takes; room of all updates; rows of the\n"
        "largest front; where columns of the lower triangle begin; their rows, the diagonal\n"
        "first; signs of pivots; the order; and places of the `chosen` values of K, then of all\n"
        "of B.",
        {METHOD(py_fronts_factor, "factor", "terms, B",
            "Return the scaled matrix, its scale and factors, and the number of the pivot that\n"
            "fails.\n\n"
            "It is 0 where all pivots have their signs."),
        METHOD(py_fronts_signs, "signs", "terms, B, counted",
            "Return by how many more pivots are negative than multipliers, and growth of\n"
            "factors.\n\n"
            "The growth is the largest sum_k L_ik^2 |D_k|, relative to the diagonal of K and to\n"
            "rows of B of length one; infinite where a pivot vanishes, or has not its sign\n"
            "unless they are `counted`."),
        METHOD_2(py_fronts_solve, "solve", "factors, right, enough",
             "Return refined solutions for right sides, the last axis, and the largest residual.\n\n"
             "Residuals up to `enough`, or a few units of round-off, are not refined. They are\n"
             "relative to the largest entries of the scaled right side and solution.")});
}

/* What models of real and of complex numbers have. */
template <class T, class M> std::vector<PyMethodDef> drivers()
{
    constexpr auto march = &py_march<T, M>;
    constexpr auto controlled = &py_march_controlled<T, M>;
    constexpr auto rest = &py_rest<T, M>;
    constexpr auto stages = &py_march_stages<T, M>;
    return {
        declared<OfSelf<Bound<march>>>("march",
            "state, motion, h, of_joints, of_loads, seconds, rows, guess, limits",
            "Take steps of sizes h from (q, v, a, lam, A), as many as can be in so many seconds.\n\n"
            "Factors of joints are (k, instants, n_parts): at the end of each step, at its\n"
            "beginning, at the three Gauss points, and their time derivatives there; two instants\n"
            "do where no step is small. Factors of loads are (k, 2, n_loads). A guess of a and lam\n"
            "replaces the one made here; limits are the tolerance, the factor by which corrections\n"
            "above round-off shrink at least, and the most iterations.\n\n"
            "Returns the number of steps taken, why it ends, the motion and a of the last state,\n"
            "counts of iterations, factorisations and steps that round-off disturbs, and of the\n"
            "last step the size of its last correction and the slowest rate of its corrections. The\n"
            "states after the steps, q, v, A and lam, are written to rows."),
        declared<OfSelf<Bound<controlled>>>("march_controlled",
            "state, at, motion, control, tolerance, laws, along, rows, of_steps, beside, limits",
            "Take steps under error control from (q, v, a, lam, A), until the rows are full.\n\n"
            "`at` holds the instant n, its time, and the size of the step that led there; the motion\n"
            "is as of `march`. Control is the numbers of a filter and stops. The tolerance is (rtol,\n"
            "least sizes, place, numbers of a vector), and limits are those of Newton's method and\n"
            "seconds. Of (t, end, h) laws return the factors of joints and of loads in that step as\n"
            "rows of the tables of `march`, with the error of its turn; without laws a number is\n"
            "added to the times in a system of one's own. `along` returns e of what goes along with a\n"
            "step, of its size and end. Rows are those of `march`, (ends, filters) belong to steps,\n"
            "and (a, motions) stand beside them. Filter and rows are written.\n\n"
            "Returns the number of steps, why it ends, how many were rejected, counts as `march`, and\n"
            "the size of the last correction."),
        declared<OfSelf<Bound<rest>>>("rest", "state, known, factors, rules",
            "Solve for an equilibrium under part of the load, from q and lam, by Newton's method.\n\n"
            "The state (q, lam, q_s, lam_s) is written in place; where corrections have stopped\n"
            "shrinking the last one stands in (q_s, lam_s). Known are (q_0, anchor or None, r_0,\n"
            "Phi_0), factors those of constraints, of loads as they act, and of those that turn; of\n"
            "a system of one's own the time, the time, and whether loads turn. Returns why it ends,\n"
            "iterations, the size of the last correction, and whether K is surely positive definite."),
        declared<OfSelf<Bound<stages>>>("march_stages",
            "coupled, before, at, control, tolerance, laws, along, rows, of_steps, settings, seconds",
            "Take steps of Radau IIA, under error control or of known sizes, until the rows are full.\n\n"
            "Before are rows (q, v, a, lam) of the start and the stages of the last step, or of one\n"
            "state; `at` and laws are as of `march_controlled`, with factors at the stages and the\n"
            "start, those of joints with two time derivatives, (12, n_parts) and (4, n_loads). Control\n"
            "is (numbers of a filter, stops, sizes, ends): either a filter or sizes are empty. The\n"
            "tolerance is None or (rtol, least sizes) of positions, the same of velocities, place,\n"
            "scale, and numbers of a vector. Rows (t, q, v, a, lam) belong to stages, (ends, filters)\n"
            "to steps. Settings are the tableau and `StageRules` of `stages.h`.\n\n"
            "Returns the number of steps, why it ends, how many were rejected, how many were solved by\n"
            "way of shorter ones, counts as `march`, size of the last correction, and the last e."),
    };
}

void models_added(PyObject *module)
{
    type_added<CoupledMatrix>(
        module, "order, scale, places, band, factorise",
        "The coupled matrix of stages: order and scale of the unknowns, places of blocks (i, j) in\n"
        "its K, and a `Band` or what factorises, as a `Model` takes it.", {});
    auto methods = drivers<double, Model>();
    methods.insert(
        methods.end(),
        {METHOD(py_differentiate_steps, "differentiate_steps", "steps, right, z, states, lam_b, first",
            "Take steps of direct differentiation from a first one on.\n\n"
            "Steps are sizes, q, v and lam that they arrived at, factors of joints (one row\n"
            "where nothing is driven) and of loads there, matrices of the recurrence\n"
            "(`step_matrices`); of a system of one's own (M, f_q, f_v, Phi_q) there; and where\n"
            "steps are small (which, G, g) (`ConstraintRow`). Returns the number of the next\n"
            "step, and why it ends as `march`. Rows of `right`, (k, n_b, n), are what is known\n"
            "of the right sides, and overwritten, as is z, (4, n_b, n_q); written are states,\n"
            "(k + 1, 3, n_b, n_q), but the row before the first step, and lam_b, (k, n_b,\n"
            "n_lam)."),
        METHOD(py_pull_back_steps, "pull_back_steps", "steps, seeds, covectors, count",
            "Take the first steps, so many, of the transposed recurrence, the last of them\n"
            "first.\n\n"
            "Returns how many are left, and why it ends as `march`. Seeds are rows on q, v and\n"
            "lam; of the covectors the first, (6, n_q), is overwritten; written are rows of mu\n"
            "and zeta, and of covectors on the defects of q, v and A, (k, 3, n_q), if asked\n"
            "for."),
        METHOD(py_embedded_errors, "embedded_errors", "h, state, factors, rows, errors, tableau",
            "Write errors dq and dv, (2, n_b, n_q), of derivatives in a step of Radau IIA.\n\n"
            "State (q, v, a, lam) and factors are those of its middle stage. Rows are v_b at start and\n"
            "stages, (4, n_b, n_q), a_b at the start, and x_b of the stages. Returns why it ends."),
        METHOD(py_find_stages, "find_stages", "factors, states, found, first",
            "Find a and lam, and v - V and sigma, of stages from a first one on.\n\n"
            "Returns the number of the next stage, and why it ends as `march`. Factors of\n"
            "joints have one derivative, (2, k, n_parts), or are any where nothing is driven;\n"
            "those of loads are (k, n_loads). Rows of q, V and rough accelerations A belong to\n"
            "stages. Written are rows of `found`, (k, 2, n)."),
        METHOD(py_differentiate_stages, "differentiate_stages", "coupled, steps, known, states, lam_b, x_b, first",
            "Take steps of Radau IIA of direct differentiation from a first one on.\n\n"
            "Steps are sizes, (k,); M, Phi_q, f_q and f_v at stages, 3 k rows, with one row of\n"
            "M where it is constant; f_q and f_v of completed stages; f_0,q; (Phi'_q, Phi''_q),\n"
            "None where these vanish; and c, A^-1 and A^-2 of the method, (21,). Returns the\n"
            "number of the next step, and why it ends as `march`. Known are f_b with Phi_b of\n"
            "stages, and the negated right sides of v_b and of a_b without what the states\n"
            "give, (3 k, n_b, n) each, and overwritten. Written are states, (3 k + 1, 3, n_b,\n"
            "n_q), and lam_b, (3 k + 1, n_b, n_lam), but their rows before the first step, and\n"
            "x_b, (3 k, n_b, n_q)."),
        METHOD(py_pull_back_stages, "pull_back_stages", "coupled, steps, seeds, on, covectors, count",
            "Take the first `count` steps of Radau IIA of the transposed recurrence, the last\n"
            "first.\n\n"
            "Returns how many are left, and why it ends as `march`. Seeds are rows on q, v and\n"
            "lam of stages; `on`, (2, n_q), is overwritten. Written are three covectors, (3 k,\n"
            "n) each: mu with zeta, and those on the right sides of v_b and of a_b; the last\n"
            "one only where there are seeds on lam.")});
    type_added<Model>(
        module, "plan, layout, rules, factorise",
        "A system with its matrices, checked once, and room for its steps.\n\n"
        "The plan has real numbers (`real_part`), the layout order and scale of the unknowns,\n"
        "and an envelope, band and fronts, or None. The rules are `MarchRules` of `march.h`. A\n"
        "function to factorise is called where the layout has no place for a matrix.",
        std::move(methods));
    type_added<ComplexModel>(
        module, "plan, model, rules",
        "A system at complex numbers, with a model of their real parts that has its matrices.",
        drivers<Complex, ComplexModel>());
}

using Named = std::initializer_list<std::pair<const char *, int>>;

/* Add numbers of C++ to the module, or to an IntEnum of it. */
void constants_added(PyObject *module, Named all)
{
    for (auto &[name, value] : all)
        if (PyModule_AddIntConstant(module, name, value) < 0)
            throw Failed();
}

void enumeration_added(PyObject *module, const char *name, Named all)
{
    Ref members = made(PyDict_New()), kind = made(PyImport_ImportModule("enum"));
    for (auto &[member, value] : all)
        if (PyDict_SetItemString(members.get(), member, Ref(given(value)).get()) < 0)
            throw Failed();
    Ref own = made(PyObject_CallMethod(kind.get(), "IntEnum", "sO", name, members.get()));
    Ref place = made(PyUnicode_FromString("ancfdae.kernels._kernels"));
    if (PyObject_SetAttrString(own.get(), "__module__", place.get()) < 0 ||
        PyModule_AddObjectRef(module, name, own.get()) < 0)
        throw Failed();
}

/* What is asked for, how something ends, and how many rules there are. */
void numbers_added(PyObject *module)
{
    enumeration_added(module, "Constraints", {{"RATE", RATE}, {"VALUES", VALUES}, {"FORCE", FORCE}});
    enumeration_added(module, "March",
                      {{"ALL_TAKEN", ALL_TAKEN},
                       {"NEEDS_GAUSS", NEEDS_GAUSS},
                       {"INDEFINITE", INDEFINITE},
                       {"OUT_OF_TIME", OUT_OF_TIME},
                       {"NO_CONVERGENCE", NO_CONVERGENCE},
                       {"NOT_FINITE", RESIDUAL_NOT_FINITE},
                       {"SINGULAR", MATRIX_SINGULAR},
                       {"INACCURATE", ERROR_TOO_LARGE},
                       {"STEP_BEFORE", STEP_BEFORE},
                       {"BEGIN_ANEW", BEGIN_ANEW}});
    enumeration_added(module, "Rest",
                      {{"SOLVED", REST_SOLVED},
                       {"NO_CONVERGENCE", REST_NO_CONVERGENCE},
                       {"NOT_FINITE", REST_NOT_FINITE},
                       {"SINGULAR", REST_SINGULAR},
                       {"INDEFINITE", REST_INDEFINITE},
                       {"STUCK", REST_STUCK}});
    constants_added(module, {{"NOT_FINITE", NOT_FINITE},
                             {"SINGULAR", SINGULAR},
                             {"ERROR_TEST", ERROR_TEST},
                             {"PLANNED", STEP_PLANNED},
                             {"FINISHED", RUN_FINISHED},
                             {"NEVER_SOLVED", NEVER_SOLVED},
                             {"NEVER_ACCURATE", NEVER_ACCURATE},
                             {"FILTER", sizeof(StepFilter) / sizeof(double)},
                             {"RULES", sizeof(MarchRules) / sizeof(double)}});
}

PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernels", nullptr, -1, nullptr, nullptr, nullptr, nullptr, nullptr};

} // namespace

PyMODINIT_FUNC PyInit__kernels(void)
{
    import_array();
    return guarded([]() -> PyObject * {
        Ref module = made(PyModule_Create(&definition));
        functions_added(module.get());
        elements_added(module.get());
        lists_added(module.get());
        plans_added(module.get());
        matrices_added(module.get());
        models_added(module.get());
        numbers_added(module.get());
        return module.release();
    });
}
