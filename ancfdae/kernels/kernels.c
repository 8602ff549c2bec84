/* Inner loops of the package: element forces and tangents, sparse products, banded solutions.
 *
 * What they compute is said in `__init__.py`, and why in docs/theory. Every formula stands once,
 * in a header that is included for real and for complex numbers.
 */

#define PY_SSIZE_T_CLEAN
/* The stable ABI: one build serves every Python from 3.11 on. */
#define Py_LIMITED_API 0x030A0000
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define NPY_TARGET_VERSION NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>

#include <complex.h>
#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#if defined(_MSC_VER) && !defined(__clang__)
#error "MSVC has no complex numbers of C; build with clang-cl or MinGW"
#endif
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif
/* Products of complex numbers without tests for infinities; where the compiler knows neither of
 * these, the tests cost time only. */
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("cx-limited-range")
#elif defined(__clang__) && __clang_major__ >= 18
#pragma STDC CX_LIMITED_RANGE ON
#endif
/* A second copy for processors with wide vectors, chosen when the module is loaded: by glibc, and
 * GCC knows that name of a processor here from version 12 on. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__gnu_linux__) &&   \
    __GNUC__ >= 12
#define WITH_WIDE_VECTORS __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define WITH_WIDE_VECTORS
#endif
/* Before a short loop that is to become one of vectors; GCC would unroll it first, and then take
 * the loop around it (measured: five times slower). */
#if defined(__GNUC__) && !defined(__clang__)
#define UNROLL_NOT _Pragma("GCC unroll 1")
#else
#define UNROLL_NOT
#endif

/* A pivot this small against the diagonal has no digit left. */
#define ROUND_OFF 1e-13
/* The largest element: 8 relative node vectors of 3 numbers. */
enum { MOST_Y = 8, MOST_G = 36, MOST_M = 24, MOST_WIDE = 32 };

#include "constraint_plan.h"
#include "load_plan.h"

/* The angle of (x, y), rad; complex numbers must be real except for a tiny imaginary step. */
static double angle_of_real(double y, double x)
{
    return atan2(y, x);
}

static double complex angle_of_complex(double complex y, double complex x)
{
    double size = creal(x) * creal(x) + creal(y) * creal(y);
    return atan2(creal(y), creal(x)) + I * ((creal(x) * cimag(y) - creal(y) * cimag(x)) / size);
}
/* Settings of Newton's method in steps of HHT-I3, numbers only (`integrators/hht/newton.py`), with
 * the places and weights of the Gauss points of small steps. */
typedef struct {
    double alpha, tolerance, max_iterations, blur, slow, near, ahead, smooth, round_off, jump, quiet;
    double places[3], weights[3];
} march_rules;

/* Step size, and Newmark coefficients with what a adds to q, v and A. */
typedef struct {
    double h, alpha, beta, gamma, in_q, in_v, in_A;
} step_coefficients;

static step_coefficients coefficients_of_step(double h, double alpha)
{
    double beta = (1 - alpha) * (1 - alpha) / 4, gamma = (1 - 2 * alpha) / 2;
    step_coefficients c = {h, alpha, beta, gamma, beta * (h * h), gamma * h, 1 / (1 + alpha)};
    return c;
}

static double seconds_now(void)
{
    struct timespec now;
    timespec_get(&now, TIME_UTC);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

#include "elimination.h"
#include "fronts.h"

#define T double
#define NAME(x) x##_real
#define MATH(x) x
#define ANGLE_OF angle_of_real
#define CLONES WITH_WIDE_VECTORS
#include "bending.h"
#include "elements.h"
#include "blocks.h"
#include "totals.h"
#undef OF_SIZE
#include "constraints.h"
#include "loads.h"
#include "lists.h"
#include "sparse.h"
#include "band.h"
#include "symmetric.h"
#include "march.h"
#include "passes.h"
#include "rest.h"
#undef T
#undef NAME
#undef MATH
#undef ANGLE_OF
#undef CLONES
#define T double complex
#define NAME(x) x##_complex
#define MATH(x) c##x
#define ANGLE_OF angle_of_complex
#define CLONES
#define ANY_SIZE
#include "bending.h"
#include "elements.h"
#include "blocks.h"
#include "totals.h"
#undef OF_SIZE
#include "constraints.h"
#include "loads.h"
#include "lists.h"
#include "sparse.h"
#include "band.h"
#include "symmetric.h"
#undef T
#undef NAME
#undef MATH
#undef ANGLE_OF
#undef CLONES
#undef ANY_SIZE

#include "constraint_totals.h"
#include "index_1.h"
#include "orders.h"

/* ---- arguments ---------------------------------------------------------------------------- */

static int wrong(const char *what)
{
    PyErr_SetString(PyExc_ValueError, what);
    return 0;
}

/* A contiguous array of a type, with at least `axes` axes. */
static int taken(PyObject *object, int type, int axes, PyArrayObject **array)
{
    *array = NULL;
    if (object == Py_None)
        return wrong("an array is missing");
    *array = (PyArrayObject *)PyArray_FROM_OTF(object, type, NPY_ARRAY_IN_ARRAY);
    if (*array == NULL)
        return 0;
    return PyArray_NDIM(*array) >= axes || wrong("an array has too few axes");
}

/* The same, or NULL for None. */
static int taken_or_none(PyObject *object, int type, int axes, PyArrayObject **array)
{
    *array = NULL;
    return object == Py_None || taken(object, type, axes, array);
}

/* A whole number from 0 to `most`. */
static int taken_number(PyObject *object, npy_intp most, npy_intp *number)
{
    *number = PyNumber_AsSsize_t(object, PyExc_ValueError);
    if (PyErr_Occurred())
        return 0;
    return (*number >= 0 && *number <= most) || wrong("a number is negative or too large");
}

/* Item i of a tuple that must have `size` items. */
static PyObject *item(PyObject *tuple, Py_ssize_t size, Py_ssize_t i)
{
    if (!tuple || !PyTuple_Check(tuple) || PyTuple_Size(tuple) != size)
        return wrong("a plan is made of named tuples"), NULL;
    return PyTuple_GetItem(tuple, i);
}

static int is_complex(PyObject *object)
{
    return PyArray_Check(object) && PyArray_ISCOMPLEX((PyArrayObject *)object);
}

static const void *data_of(PyArrayObject *array)
{
    return array ? PyArray_DATA(array) : NULL;
}

/* Zeros with the leading axes of an array but its last `dropped`, and then `count` more. */
static PyArrayObject *zeros_like(PyArrayObject *model, int dropped, int count,
                                 const npy_intp *more, int type)
{
    npy_intp shape[NPY_MAXDIMS];
    int leading = PyArray_NDIM(model) - dropped;
    if (leading + count > NPY_MAXDIMS) {
        wrong("an array has too many axes");
        return NULL;
    }
    for (int i = 0; i < leading; i++)
        shape[i] = PyArray_DIM(model, i);
    for (int i = 0; i < count; i++)
        shape[leading + i] = more[i];
    return (PyArrayObject *)PyArray_ZEROS(leading + count, shape, type, 0);
}

static npy_intp leading_size(PyArrayObject *array, int dropped)
{
    npy_intp size = 1;
    for (int i = 0; i < PyArray_NDIM(array) - dropped; i++)
        size *= PyArray_DIM(array, i);
    return size;
}

/* Whether the last axes of an array are these. */
static int ends_with(PyArrayObject *array, int count, const npy_intp *shape)
{
    int leading = PyArray_NDIM(array) - count;
    for (int i = 0; i < count; i++)
        if (leading < 0 || PyArray_DIM(array, leading + i) != shape[i])
            return 0;
    return 1;
}

/* Whether all of `size` numbers lie from `least` to `most`: else x - least or most - x has the bit
 * of the sign. Without branches this costs next to nothing. */
static int within_32(PyArrayObject *array, npy_intp least, npy_intp most)
{
    const npy_uint32 *x = PyArray_DATA(array), low = (npy_uint32)least;
    const npy_uint32 high = (npy_uint32)(most < NPY_MAX_INT32 ? most : NPY_MAX_INT32);
    npy_uint32 bits = 0;
    for (npy_intp i = 0, size = PyArray_SIZE(array); i < size; i++)
        bits |= (x[i] - low) | (high - x[i]);
    return bits >> 31 == 0;
}

static int within_64(PyArrayObject *array, npy_intp most)
{
    const npy_uint64 *x = PyArray_DATA(array), high = (npy_uint64)most;
    npy_uint64 bits = 0;
    for (npy_intp i = 0, size = PyArray_SIZE(array); i < size; i++)
        bits |= x[i] | (high - x[i]);
    return bits >> 63 == 0;
}

/* ---- blocks of elements -------------------------------------------------------------------- */

enum { BLOCK_ITEMS = 7, MOST_STATES = 6 };

/* A block (A, g_o, bending, tau, vectors, d, n_q) with states, all of one type. */
typedef struct {
    PyArrayObject *A, *g_o, *bending, *tau, *vectors, *states[MOST_STATES];
    int n_y, d, type;
    npy_intp n, n_q;
} Arguments;

static void dropped(Arguments *a)
{
    Py_XDECREF(a->A);
    Py_XDECREF(a->g_o);
    Py_XDECREF(a->bending);
    Py_XDECREF(a->tau);
    Py_XDECREF(a->vectors);
    for (int i = 0; i < MOST_STATES; i++)
        Py_XDECREF(a->states[i]);
}

static int sized(Arguments *a, npy_intp n_y, npy_intp d)
{
    a->n_y = (int)n_y;
    a->d = (int)d;
    return (n_y >= 1 && n_y <= MOST_Y && d >= 1 && d <= 3) ||
           wrong("an element has at most 8 relative node vectors of 3 numbers");
}

static int filled(Arguments *a, PyObject *block, PyObject *const *states, int count)
{
    memset(a, 0, sizeof *a);
    if (!PyTuple_Check(block) || PyTuple_Size(block) != BLOCK_ITEMS)
        return wrong("a block is (A, g_o, bending, tau, vectors, d, n_q)");
    PyObject *items[BLOCK_ITEMS];
    npy_intp d;
    a->type = NPY_DOUBLE;
    for (int i = 0; i < BLOCK_ITEMS; i++)
        items[i] = PyTuple_GetItem(block, i);
    for (int i = 0; i < 4; i++)
        if (is_complex(items[i]))
            a->type = NPY_CDOUBLE;
    for (int i = 0; i < count; i++)
        if (is_complex(states[i]))
            a->type = NPY_CDOUBLE;
    if (!taken(items[0], a->type, 3, &a->A) || !taken(items[1], a->type, 2, &a->g_o) ||
        !taken_or_none(items[2], a->type, 2, &a->bending) ||
        !taken_or_none(items[3], a->type, 1, &a->tau) ||
        !taken(items[4], NPY_INT64, 2, &a->vectors) || !taken_number(items[5], 3, &d) ||
        !taken_number(items[6], NPY_MAX_INTP, &a->n_q))
        return 0;
    for (int i = 0; i < count; i++)
        if (!taken_or_none(states[i], a->type, 1, &a->states[i]))
            return 0;
    a->n = leading_size(a->vectors, 1);
    if (!sized(a, PyArray_DIM(a->vectors, PyArray_NDIM(a->vectors) - 1) - 1, d))
        return 0;
    return within_64(a->vectors, a->n_q / d - 1) || wrong("a node vector is not among n_q numbers");
}

/* Whether states come in pairs of one shape, with n_q numbers in the last axis; the second of a
 * pair may be missing. */
static int fitting(const Arguments *a, int count)
{
    for (int i = 0; i < count; i++) {
        PyArrayObject *x = a->states[i], *first = a->states[i - i % 2];
        if (!x && i % 2)
            continue;
        if (!x || !ends_with(x, 1, &a->n_q) || !PyArray_SAMESHAPE(x, first))
            return wrong("states must have n_q numbers, and velocities the shape of coordinates");
    }
    return 1;
}

/* Whether the law is that of all n elements, or one for all. */
static int lawful(const Arguments *a)
{
    npy_intp n_g = (npy_intp)a->n_y * (a->n_y + 1) / 2, shape[] = {n_g, n_g};
    npy_intp laws = leading_size(a->A, 2), two = 2;
    if (!ends_with(a->A, 2, shape) || !ends_with(a->g_o, 1, shape) ||
        leading_size(a->g_o, 1) != laws || (laws != 1 && laws != a->n) ||
        (a->bending && (a->n_y < 3 || !ends_with(a->bending, 1, &two) ||
                        leading_size(a->bending, 1) != laws)) ||
        (a->tau && PyArray_SIZE(a->tau) != a->n))
        return wrong("A, g_o and bending must be those of one element or of all, and tau of all");
    return 1;
}

/* Elements times instants that are worth releasing the lock of the interpreter. */
enum { MUCH = 16 };

/* Run f for the type of the arguments, at k instants. */
#define BLOCK_OF_TYPE(kind)                                                                        \
    block_##kind b = {a.n,                                                                         \
                      a.n_q,                                                                       \
                      a.A && leading_size(a.A, 2) == 1,                                            \
                      k,                                                                           \
                      data_of(a.vectors),                                                          \
                      data_of(a.A),                                                                \
                      data_of(a.g_o),                                                              \
                      data_of(a.bending),                                                              \
                      data_of(a.tau)};
#define FOR_TYPE(f, ...)                                                                           \
    do {                                                                                           \
        PyThreadState *kept = k * a.n > MUCH ? PyEval_SaveThread() : NULL;                         \
        if (a.type == NPY_DOUBLE) {                                                                \
            BLOCK_OF_TYPE(real)                                                                    \
            f##_real(a.n_y, a.d, &b, __VA_ARGS__);                                                 \
        } else {                                                                                   \
            BLOCK_OF_TYPE(complex)                                                                 \
            f##_complex(a.n_y, a.d, &b, __VA_ARGS__);                                              \
        }                                                                                          \
        if (kept)                                                                                  \
            PyEval_RestoreThread(kept);                                                            \
    } while (0)

static PyObject *py_relative(PyObject *const *args)
{
    Arguments a;
    PyArrayObject *out = NULL;
    if (filled(&a, args[0], args + 1, 1) && fitting(&a, 1)) {
        npy_intp k = leading_size(a.states[0], 1), more[] = {a.n, a.n_y, a.d};
        out = zeros_like(a.states[0], 1, 3, more, a.type);
        if (out)
            FOR_TYPE(relative, data_of(a.states[0]), PyArray_DATA(out));
    }
    dropped(&a);
    return (PyObject *)out;
}

static PyObject *py_lifted(PyObject *const *args)
{
    Arguments a;
    PyArrayObject *out = NULL;
    if (filled(&a, args[0], args + 1, 1)) {
        npy_intp shape[] = {a.n, a.n_y, a.d};
        if (!a.states[0] || !ends_with(a.states[0], 3, shape))
            wrong("forces must have the shape of relative node vectors");
        else {
            npy_intp k = leading_size(a.states[0], 3);
            out = zeros_like(a.states[0], 3, 1, &a.n_q, a.type);
            if (out)
                FOR_TYPE(lifted, data_of(a.states[0]), PyArray_DATA(out));
        }
    }
    dropped(&a);
    return (PyObject *)out;
}

static PyObject *py_forces(PyObject *const *args)
{
    Arguments a;
    PyArrayObject *out = NULL;
    if (filled(&a, args[0], args + 1, 2) && fitting(&a, 2) && lawful(&a)) {
        npy_intp k = leading_size(a.states[0], 1);
        out = zeros_like(a.states[0], 1, 1, &a.n_q, a.type);
        if (out)
            FOR_TYPE(forces, data_of(a.states[0]), data_of(a.states[1]), PyArray_DATA(out));
    }
    dropped(&a);
    return (PyObject *)out;
}

/* Whether k directions belong to one state or to k, with velocities of both or of none. */
static int directed(const Arguments *a, npy_intp k)
{
    npy_intp states = leading_size(a->states[0], 1);
    return ((states == 1 || states == k) && (!a->states[1] || a->states[3])) ||
           wrong("there must be one state for all directions or one for each");
}

static PyObject *py_forces_along(PyObject *const *args)
{
    Arguments a;
    PyArrayObject *out = NULL;
    if (filled(&a, args[0], args + 1, 4) && fitting(&a, 4) && lawful(&a)) {
        npy_intp k = leading_size(a.states[2], 1);
        if (directed(&a, k))
            out = zeros_like(a.states[2], 1, 1, &a.n_q, a.type);
        if (out)
            FOR_TYPE(forces_along, leading_size(a.states[0], 1) == 1, data_of(a.states[0]),
                     data_of(a.states[1]), data_of(a.states[2]), data_of(a.states[3]),
                     PyArray_DATA(out));
    }
    dropped(&a);
    return (PyObject *)out;
}

/* Whether partials A_b, rest_b and tau_b, states from `at` on, are those of the pairs of n elements
 * and n_b variables. */
static int paired(const Arguments *a, int at, PyArrayObject *const *index, npy_intp n_b)
{
    npy_intp n_g = (npy_intp)a->n_y * (a->n_y + 1) / 2, shape[] = {n_g, n_g}, rest = n_g + 2;
    PyArrayObject *A_b = a->states[at], *rest_b = a->states[at + 1], *tau_b = a->states[at + 2];
    npy_intp n_stiff = A_b ? leading_size(A_b, 2) : 0, n_damped = tau_b ? PyArray_SIZE(tau_b) : 0;
    const npy_int64 *first = PyArray_DATA(index[0]);
    npy_intp size = PyArray_SIZE(index[1]);
    int in_order = PyArray_SIZE(index[0]) == a->n + 1 && first[0] == 0 && first[a->n] == size;
    for (npy_intp e = 0; in_order && e < a->n; e++)
        in_order = first[e] <= first[e + 1];
    return (in_order && A_b && rest_b && ends_with(A_b, 2, shape) && ends_with(rest_b, 1, &rest) &&
            leading_size(rest_b, 1) == n_stiff && (n_damped == 0 || a->states[1]) &&
            size == PyArray_SIZE(index[2]) && within_64(index[1], n_stiff + n_damped - 1) &&
            within_64(index[2], n_b - 1)) ||
           wrong("partials must be those of pairs of elements and variables, one row each");
}

/* Take A_b, rest_b and tau_b, states from `at` on, and the pairs behind them. */
#define LAW_OF_TYPE(kind)                                                                          \
    law_partials_##kind law = {leading_size(a.states[at], 2), data_of(index[0]),                   \
                               data_of(index[1]),             data_of(index[2]),                   \
                               data_of(a.states[at]),         data_of(a.states[at + 1]),           \
                               data_of(a.states[at + 2])};

static int pairs_taken(PyObject *const *args, PyArrayObject **index)
{
    for (int i = 0; i < 3; i++)
        if (!taken(args[i], NPY_INT64, 1, &index[i]))
            return 0;
    return 1;
}

static PyObject *py_force_totals(PyObject *const *args)
{
    enum { at = 2 };
    Arguments a;
    PyArrayObject *out = NULL, *index[3] = {NULL, NULL, NULL};
    int whole = filled(&a, args[0], args + 1, 5) && fitting(&a, 2) && lawful(&a) &&
                pairs_taken(args + 6, index);
    if (whole && paired(&a, at, index, leading_size(a.states[0], 1) - 1)) {
        npy_intp k = leading_size(a.states[0], 1);
        out = zeros_like(a.states[0], 1, 1, &a.n_q, a.type);
        if (out && k && a.type == NPY_DOUBLE) {
            BLOCK_OF_TYPE(real)
            LAW_OF_TYPE(real)
            force_totals_real(a.n_y, a.d, &b, &law, data_of(a.states[0]), data_of(a.states[1]),
                              PyArray_DATA(out));
        } else if (out && k) {
            BLOCK_OF_TYPE(complex)
            LAW_OF_TYPE(complex)
            force_totals_complex(a.n_y, a.d, &b, &law, data_of(a.states[0]), data_of(a.states[1]),
                                 PyArray_DATA(out));
        }
    }
    for (int i = 0; i < 3; i++)
        Py_XDECREF(index[i]);
    dropped(&a);
    return (PyObject *)out;
}

static PyObject *py_force_partials(PyObject *const *args)
{
    enum { at = 3 };
    Arguments a;
    npy_intp n_b;
    PyArrayObject *out = NULL, *index[3] = {NULL, NULL, NULL};
    int whole = filled(&a, args[0], args + 1, 6) && fitting(&a, 2) && lawful(&a) &&
                pairs_taken(args + 7, index) && taken_number(args[10], NPY_MAX_INTP, &n_b);
    if (whole && a.states[2] && !PyArray_SAMESHAPE(a.states[2], a.states[0]))
        whole = wrong("covectors must have the shape of coordinates");
    if (whole && paired(&a, at, index, n_b)) {
        npy_intp k = leading_size(a.states[0], 1), rows[] = {k, n_b, a.n_q};
        int summed = a.states[2] != NULL;
        out = (PyArrayObject *)PyArray_ZEROS(summed ? 1 : 3, rows + summed, a.type, 0);
        void *to = out ? PyArray_DATA(out) : NULL;
        const void *mu = data_of(a.states[2]), *q = data_of(a.states[0]), *v = data_of(a.states[1]);
        PyThreadState *kept = PyEval_SaveThread();
        if (out && a.type == NPY_DOUBLE) {
            BLOCK_OF_TYPE(real)
            LAW_OF_TYPE(real)
            force_partials_real(a.n_y, a.d, &b, &law, n_b, q, v, mu, to);
        } else if (out) {
            BLOCK_OF_TYPE(complex)
            LAW_OF_TYPE(complex)
            force_partials_complex(a.n_y, a.d, &b, &law, n_b, q, v, mu, to);
        }
        PyEval_RestoreThread(kept);
    }
    for (int i = 0; i < 3; i++)
        Py_XDECREF(index[i]);
    dropped(&a);
    return (PyObject *)out;
}

static PyObject *py_tangents(PyObject *const *args)
{
    Arguments a;
    PyArrayObject *out = NULL, *index = NULL;
    int damping = PyObject_IsTrue(args[3]);
    npy_intp nnz;
    if (damping < 0 || !taken_number(args[5], NPY_MAX_INTP, &nnz) ||
        !taken(args[4], NPY_INT32, 1, &index)) {
        Py_XDECREF(index);
        return NULL;
    }
    if (filled(&a, args[0], args + 1, 2) && fitting(&a, 2) && lawful(&a)) {
        npy_intp k = leading_size(a.states[0], 1), size = (npy_intp)(a.n_y + 1) * a.d;
        if (PyArray_SIZE(index) != a.n * size * size || !within_32(index, 0, nnz - 1))
            wrong("index must hold a place among the values for each entry of each element");
        else
            out = zeros_like(a.states[0], 1, 1, &nnz, a.type);
        if (out)
            FOR_TYPE(tangents, data_of(a.states[0]), data_of(a.states[1]), damping,
                     data_of(index), nnz, PyArray_DATA(out));
    }
    Py_DECREF(index);
    dropped(&a);
    return (PyObject *)out;
}

/* ---- packed matrices ----------------------------------------------------------------------- */

/* Whether there is one g_o for all elements or one for each, and a tau for each. */
static int referred(const Arguments *a, npy_intp n_g)
{
    if ((a->g_o && (!ends_with(a->g_o, 1, &n_g) ||
                    (leading_size(a->g_o, 1) != 1 && leading_size(a->g_o, 1) != a->n))) ||
        (a->tau && PyArray_SIZE(a->tau) != a->n))
        return wrong("g_o must be that of one element or of all, and tau of all");
    return 1;
}

/* gram(Y, U) where g_o is NULL, else strain(g_o, Y, U, tau); Y has shape (..., n, n_y, d). */
static PyObject *packed(PyObject *g_o, PyObject *Y, PyObject *U, PyObject *tau)
{
    Arguments a;
    PyArrayObject *out = NULL;
    memset(&a, 0, sizeof a);
    a.type = (g_o && is_complex(g_o)) || is_complex(Y) || is_complex(U) || is_complex(tau)
                 ? NPY_CDOUBLE
                 : NPY_DOUBLE;
    if (taken(Y, a.type, 2, &a.states[0]) && taken_or_none(U, a.type, 2, &a.states[1]) &&
        (g_o ? taken(g_o, a.type, 1, &a.g_o) : a.states[1] || wrong("an array is missing")) &&
        taken_or_none(tau, a.type, 1, &a.tau)) {
        int axes = PyArray_NDIM(a.states[0]);
        npy_intp n_y = PyArray_DIM(a.states[0], axes - 2), n_g = n_y * (n_y + 1) / 2;
        a.n = axes > 2 ? PyArray_DIM(a.states[0], axes - 3) : 1;
        npy_intp k = a.n ? leading_size(a.states[0], 2) / a.n : 0;
        if (a.states[1] && !PyArray_SAMESHAPE(a.states[0], a.states[1]))
            wrong("node vectors must have one shape");
        else if (sized(&a, n_y, PyArray_DIM(a.states[0], axes - 1)) && referred(&a, n_g))
            out = zeros_like(a.states[0], 2, 1, &n_g, a.type);
        if (out)
            FOR_TYPE(packed, a.g_o && leading_size(a.g_o, 1) == 1, data_of(a.states[0]),
                     data_of(a.states[1]), PyArray_DATA(out));
    }
    dropped(&a);
    return (PyObject *)out;
}

static PyObject *py_gram(PyObject *const *args)
{
    return packed(NULL, args[0], args[1], Py_None);
}

static PyObject *py_strain(PyObject *const *args)
{
    return packed(args[0], args[1], args[2], args[3]);
}

static PyObject *py_stressed(PyObject *const *args)
{
    int type = is_complex(args[0]) || is_complex(args[1]) ? NPY_CDOUBLE : NPY_DOUBLE;
    Arguments a;
    PyArrayObject *p = NULL, *Y = NULL, *out = NULL;
    if (taken(args[0], type, 1, &p) && taken(args[1], type, 2, &Y)) {
        int axes = PyArray_NDIM(Y);
        npy_intp n_y = PyArray_DIM(Y, axes - 2), n_g = n_y * (n_y + 1) / 2;
        npy_intp n = leading_size(Y, 2);
        if (leading_size(p, 1) != n || !ends_with(p, 1, &n_g))
            wrong("there must be one p for each set of node vectors");
        else if (sized(&a, n_y, PyArray_DIM(Y, axes - 1)))
            out = zeros_like(Y, 0, 0, NULL, type);
        if (out && type == NPY_DOUBLE)
            stressed_each_real(a.n_y, a.d, n, data_of(p), data_of(Y), PyArray_DATA(out));
        else if (out)
            stressed_each_complex(a.n_y, a.d, n, data_of(p), data_of(Y), PyArray_DATA(out));
    }
    Py_XDECREF(p);
    Py_XDECREF(Y);
    return (PyObject *)out;
}

/* ---- constraints ----------------------------------------------------------------------------- */

#include "constraint_calls.h"
#include "load_calls.h"
#include "list_calls.h"

/* ---- linear algebra ------------------------------------------------------------------------ */

/* Whether rows are in order, all entries are in them, and in a matrix with `n_columns` columns. */
static int is_csr(PyArrayObject *first, PyArrayObject *columns, PyArrayObject *values,
                  npy_intp n_columns)
{
    const npy_int32 *at = PyArray_DATA(first);
    npy_intp n = PyArray_SIZE(first) - 1, size = PyArray_SIZE(columns);
    int out_of_order = n < 0 || at[0] || at[n] != size || PyArray_SIZE(values) != size;
    for (npy_intp i = 0; i < n; i++)
        out_of_order |= at[i + 1] < at[i];
    return (!out_of_order && within_32(columns, 0, n_columns - 1)) ||
           wrong("these are not the compressed sparse rows of a matrix of this size");
}

/* Rows of x times the matrix (transposed), or times its transpose, with `size` numbers then. */
/* A matrix in compressed sparse rows with rows x, all of one type. */
typedef struct {
    PyArrayObject *first, *columns, *values, *x;
    npy_intp n, k, width;
    int type;
} Csr;

static int csr_taken(PyObject *const *args, Csr *m, PyObject *x)
{
    memset(m, 0, sizeof *m);
    m->type = is_complex(args[2]) || is_complex(x) ? NPY_CDOUBLE : NPY_DOUBLE;
    if (!taken(args[0], NPY_INT32, 1, &m->first) || !taken(args[1], NPY_INT32, 1, &m->columns) ||
        !taken(args[2], m->type, 1, &m->values) || !taken(x, m->type, 1, &m->x))
        return 0;
    m->k = leading_size(m->x, 1);
    m->n = PyArray_SIZE(m->first) - 1;
    m->width = PyArray_DIM(m->x, PyArray_NDIM(m->x) - 1);
    return 1;
}

static void csr_dropped(Csr *m)
{
    Py_XDECREF(m->first);
    Py_XDECREF(m->columns);
    Py_XDECREF(m->values);
    Py_XDECREF(m->x);
}

/* Add s M x, or s M^T x, to rows of `width` numbers. */
static int csr_added(const Csr *m, int transposed, double s, npy_intp width, void *out)
{
    const npy_int32 *first = data_of(m->first), *columns = data_of(m->columns);
    int is_c = m->type == NPY_CDOUBLE;
    if (transposed) {
        if (is_c)
            csr_rows_transposed_complex(m->n, first, columns, data_of(m->values), m->k,
                                        data_of(m->x), s, width, out);
        else
            csr_rows_transposed_real(m->n, first, columns, data_of(m->values), m->k,
                                     data_of(m->x), s, width, out);
        return 1;
    }
    void *work = m->k > 1 ? PyMem_Malloc(8 * (size_t)m->width * (is_c ? 16 : 8) + 1) : NULL;
    if (m->k > 1 && !work)
        return PyErr_NoMemory(), 0;
    if (is_c)
        csr_rows_complex(m->n, first, columns, data_of(m->values), m->k, m->width, data_of(m->x),
                         work, s, width, out);
    else
        csr_rows_real(m->n, first, columns, data_of(m->values), m->k, m->width, data_of(m->x),
                      work, s, width, out);
    PyMem_Free(work);
    return 1;
}

static PyObject *csr(PyObject *const *args, npy_intp size, int transposed)
{
    Csr m;
    PyArrayObject *out = NULL;
    if (csr_taken(args, &m, args[3])) {
        npy_intp of_x = transposed ? size : m.width, of_out = transposed ? size : m.n;
        if (transposed && m.width != m.n)
            wrong("x must have one number for each row of the matrix");
        else if (is_csr(m.first, m.columns, m.values, of_x))
            out = zeros_like(m.x, 1, 1, &of_out, m.type);
        if (out && !csr_added(&m, transposed, 1, of_out, PyArray_DATA(out)))
            Py_CLEAR(out);
    }
    csr_dropped(&m);
    return (PyObject *)out;
}

static PyObject *py_csr_rows(PyObject *const *args)
{
    return csr(args, 0, 0);
}

static PyObject *py_csr_rows_transposed(PyObject *const *args)
{
    npy_intp size;
    return taken_number(args[4], NPY_MAX_INTP, &size) ? csr(args, size, 1) : NULL;
}

/* csr_subtract(first, columns, values, x, out, offset, transposed): takes M x, or M^T x, from rows
 * of out, in place, at the numbers from the offset on. */
static PyObject *py_csr_subtract(PyObject *const *args)
{
    Csr m;
    npy_intp offset;
    int done = 0, transposed = PyObject_IsTrue(args[6]);
    PyArrayObject *out = (PyArrayObject *)args[4];
    if (csr_taken(args, &m, args[3]) && taken_number(args[5], NPY_MAX_INTP, &offset)) {
        int rows = PyArray_Check(args[4]) && PyArray_ISCARRAY(out) && PyArray_NDIM(out) > 0;
        npy_intp width = rows ? PyArray_DIM(out, PyArray_NDIM(out) - 1) : 0, left = width - offset;
        if (!rows || PyArray_TYPE(out) != m.type || leading_size(out, 1) != m.k || left < 0 ||
            (transposed ? m.width != m.n : left < m.n))
            wrong("out must be rows of the type of the product, one for each of x");
        else if (is_csr(m.first, m.columns, m.values, transposed ? left : m.width))
            done = csr_added(&m, transposed, -1, width,
                             PyArray_BYTES(out) + offset * PyArray_ITEMSIZE(out));
    }
    csr_dropped(&m);
    return done ? Py_NewRef(Py_None) : NULL;
}

/* Patterns (first, columns) of rows with columns below n. */
static int pattern_taken(PyObject *const *args, npy_intp n, PyArrayObject **first,
                         PyArrayObject **columns)
{
    return taken(args[0], NPY_INT32, 1, first) && taken(args[1], NPY_INT32, 1, columns) &&
           is_csr(*first, *columns, *columns, n);
}

/* narrow_order(first_K, columns_K, first_B, columns_B): an order of coordinates and multipliers. */
static PyObject *py_narrow_order(PyObject *const *args)
{
    PyArrayObject *first[2] = {NULL}, *columns[2] = {NULL}, *order = NULL;
    npy_int32 *room = NULL;
    npy_int64 *other = NULL;
    npy_intp n = PyArray_Check(args[0]) ? PyArray_SIZE((PyArrayObject *)args[0]) - 1 : 0;
    if (pattern_taken(args, n, &first[0], &columns[0]) &&
        pattern_taken(args + 2, n, &first[1], &columns[1])) {
        npy_intp m = PyArray_SIZE(first[1]) - 1, size = n + m;
        room = PyMem_Malloc((size_t)(8 * size + 8 + PyArray_SIZE(columns[1])) * sizeof *room);
        other = PyMem_Malloc((size_t)size * sizeof *other + 1);
        order = room && other ? (PyArrayObject *)PyArray_SimpleNew(1, &size, NPY_INT64) : NULL;
        if (size > NPY_MAX_INT32 / 8 || (m && !n)) {
            wrong("there must be coordinates, and indices of 32 bits for them");
            Py_CLEAR(order);
        } else if (!order)
            PyErr_NoMemory();
    }
    if (order) {
        graph g = {n, PyArray_SIZE(first[1]) - 1, data_of(first[0]), data_of(columns[0]),
                   data_of(first[1]), data_of(columns[1]), NULL, NULL, NULL, NULL, NULL};
        graph_narrow(&g, room, PyArray_DATA(order), other);
    }
    PyMem_Free(room);
    PyMem_Free(other);
    for (int i = 0; i < 2; i++) {
        Py_XDECREF(first[i]);
        Py_XDECREF(columns[i]);
    }
    return (PyObject *)order;
}

/* recombine(matrix, z, after, ahead): rows of matrix times z; three of them to `after`, and three
 * to `ahead`, in place, which may be rows of z. */
static PyObject *py_recombine(PyObject *const *args)
{
    enum { ROWS = 6, FROM = 4 };
    PyArrayObject *matrix = NULL, *z = (PyArrayObject *)args[1], *to[2];
    for (int k = 0; k < 2; k++)
        to[k] = (PyArrayObject *)args[2 + k];
    if (!taken(args[0], NPY_DOUBLE, 2, &matrix))
        return Py_XDECREF(matrix), NULL;
    npy_intp shape[] = {ROWS, FROM}, size = 0;
    int good = PyArray_NDIM(matrix) == 2 && ends_with(matrix, 2, shape);
    for (int k = 0; good && k < 3; k++) {
        PyArrayObject *x = (PyArrayObject *)args[1 + k];
        good = PyArray_Check(args[1 + k]) && PyArray_ISCARRAY(x) &&
               PyArray_TYPE(x) == NPY_DOUBLE && PyArray_NDIM(x) > 0 &&
               PyArray_DIM(x, 0) == (k ? 3 : FROM);
        if (good && k == 0)
            size = PyArray_SIZE(x) / FROM;
        good = good && PyArray_SIZE(x) == (k ? 3 : FROM) * size;
    }
    if (!good)
        wrong("there must be a matrix of 6 x 4, four rows in place and twice three");
    else
        recombined(data_of(matrix), data_of(z), size, PyArray_DATA(to[0]), PyArray_DATA(to[1]));
    Py_DECREF(matrix);
    return good ? Py_NewRef(Py_None) : NULL;
}

/* norm(x, weights, ...): sqrt(sum(weights x^2)) of the real part, added up over pairs. */
static PyObject *py_norm(PyObject *const *args, Py_ssize_t count)
{
    double total = 0;
    int good = count > 0 && count % 2 == 0;
    if (!good)
        wrong("norm takes pairs of arguments");
    for (Py_ssize_t k = 0; good && k < count; k += 2) {
        int stride = is_complex(args[k]) ? 2 : 1;
        PyArrayObject *x = NULL, *weights = NULL;
        good = taken(args[k], stride == 2 ? NPY_CDOUBLE : NPY_DOUBLE, 0, &x) &&
               taken(args[k + 1], NPY_DOUBLE, 0, &weights) &&
               (PyArray_SIZE(x) == PyArray_SIZE(weights) ||
                wrong("there must be one weight for each number"));
        if (good) {
            const double *from = data_of(x), *w = data_of(weights);
            double sum = 0;
            for (npy_intp i = 0; i < PyArray_SIZE(x); i++)
                sum += w[i] * from[i * stride] * from[i * stride];
            total += sqrt(sum);
        }
        Py_XDECREF(x);
        Py_XDECREF(weights);
    }
    return good ? PyFloat_FromDouble(total) : NULL;
}

/* add_scaled(x, s, y): x + s y; NumPy's own operators where these are not real arrays alike. */
static PyObject *py_add_scaled(PyObject *const *args)
{
    PyArrayObject *x = (PyArrayObject *)args[0], *y = (PyArrayObject *)args[2], *out;
    if (!PyFloat_Check(args[1]) || !PyArray_Check(x) || !PyArray_Check(y) ||
        PyArray_TYPE(x) != NPY_DOUBLE || PyArray_TYPE(y) != NPY_DOUBLE ||
        !PyArray_ISCARRAY_RO(x) || !PyArray_ISCARRAY_RO(y) || !PyArray_SAMESHAPE(x, y)) {
        PyObject *product = PyNumber_Multiply(args[1], args[2]), *sum;
        if (!product)
            return NULL;
        sum = PyNumber_Add(args[0], product);
        Py_DECREF(product);
        return sum;
    }
    out = (PyArrayObject *)PyArray_SimpleNew(PyArray_NDIM(x), PyArray_DIMS(x), NPY_DOUBLE);
    if (out) {
        const double *from = data_of(x), *added = data_of(y), s = PyFloat_AsDouble(args[1]);
        double *to = PyArray_DATA(out);
        for (npy_intp i = 0; i < PyArray_SIZE(x); i++)
            to[i] = from[i] + s * added[i];
    }
    return (PyObject *)out;
}

/* balance(inertia, reaction, force, constraint, s): inertia + reaction - force, and behind it
 * s times the constraint. */
static PyObject *py_balance(PyObject *const *args)
{
    int type = NPY_DOUBLE;
    PyArrayObject *x[4] = {NULL}, *out = NULL;
    double s = PyFloat_AsDouble(args[4]);
    int good = !PyErr_Occurred();
    for (int k = 0; k < 4; k++)
        if (is_complex(args[k]))
            type = NPY_CDOUBLE;
    for (int k = 0; good && k < 4; k++)
        good = taken(args[k], type, 1, &x[k]);
    if (good && (PyArray_SIZE(x[0]) != PyArray_SIZE(x[1]) || PyArray_SIZE(x[0]) != PyArray_SIZE(x[2])))
        good = wrong("forces must have one size");
    if (good) {
        npy_intp n = PyArray_SIZE(x[0]), size = n + PyArray_SIZE(x[3]);
        out = (PyArrayObject *)PyArray_SimpleNew(1, &size, type);
        if (out) {
            /* Real and imaginary parts go the same way. */
            int parts = type == NPY_CDOUBLE ? 2 : 1;
            const double *a = data_of(x[0]), *b = data_of(x[1]), *c = data_of(x[2]), *d = data_of(x[3]);
            double *to = PyArray_DATA(out);
            for (npy_intp i = 0; i < n * parts; i++)
                to[i] = a[i] + b[i] - c[i];
            for (npy_intp i = 0; i < (size - n) * parts; i++)
                to[n * parts + i] = s * d[i];
        }
    }
    for (int k = 0; k < 4; k++)
        Py_XDECREF(x[k]);
    return (PyObject *)out;
}

/* finite(x): whether every number is. */
static PyObject *py_finite(PyObject *const *args)
{
    int is_c = is_complex(args[0]);
    PyArrayObject *x = NULL;
    if (!taken(args[0], is_c ? NPY_CDOUBLE : NPY_DOUBLE, 0, &x))
        return NULL;
    const double *from = data_of(x);
    npy_intp size = PyArray_SIZE(x) * (is_c ? 2 : 1), i = 0;
    /* Zero times what is not finite is not a number; sums apart do not wait for each other. */
    double sum[8] = {0};
    for (; i + 8 <= size; i += 8)
        for (int k = 0; k < 8; k++)
            sum[k] += 0 * from[i + k];
    for (; i < size; i++)
        sum[0] += 0 * from[i];
    for (int k = 1; k < 8; k++)
        sum[0] += sum[k];
    Py_DECREF(x);
    return PyBool_FromLong(sum[0] == 0);
}

/* A LAPACK routine of SciPy, kept once it is found. The capsule that holds it is named after its
 * arguments: they must begin so. */
static void *lapack(void **kept, const char *name, const char *beginning)
{
    if (*kept)
        return *kept;
    PyObject *module = PyImport_ImportModule("scipy.linalg.cython_lapack");
    PyObject *routines = module ? PyObject_GetAttrString(module, "__pyx_capi__") : NULL;
    PyObject *capsule = routines ? PyMapping_GetItemString(routines, name) : NULL;
    const char *arguments = capsule ? PyCapsule_GetName(capsule) : NULL;
    if (arguments && strncmp(arguments, beginning, strlen(beginning)) == 0)
        *kept = PyCapsule_GetPointer(capsule, arguments);
    else if (!PyErr_Occurred())
        PyErr_Format(PyExc_ImportError,
                     "%s of this SciPy is not LAPACK's with 32-bit integers, but %s", name,
                     arguments ? arguments : "nameless");
    Py_XDECREF(capsule);
    Py_XDECREF(routines);
    Py_XDECREF(module);
    return *kept;
}

/* band_factor(K, B, factors, flat, n, half): the factors, (n, 3 half + 1), pivots, what B is scaled
 * by, and info. */
static PyObject *py_band_factor(PyObject *const *args)
{
    static void *routines[2];
    int type = is_complex(args[0]) || is_complex(args[1]) ? NPY_CDOUBLE : NPY_DOUBLE, info = 0;
    npy_intp n, half;
    double of_B = 1;
    PyArrayObject *K = NULL, *B = NULL, *factors = NULL, *flat = NULL, *lu = NULL, *pivots = NULL;
    PyObject *result = NULL;
    void *routine = lapack(&routines[type == NPY_CDOUBLE],
                           type == NPY_CDOUBLE ? "zgbtrf" : "dgbtrf",
                           "void (int *, int *, int *, int *, ");
    if (!routine || !taken_number(args[4], INT_MAX, &n) ||
        !taken_number(args[5], (INT_MAX - 1) / 3, &half))
        return NULL;
    npy_intp shape[] = {n, 3 * half + 1};
    if (taken(args[0], type, 0, &K) && taken(args[1], type, 0, &B) &&
        taken(args[2], NPY_DOUBLE, 0, &factors) && taken(args[3], NPY_INT64, 0, &flat) &&
        (lu = (PyArrayObject *)PyArray_ZEROS(2, shape, type, 0)) &&
        (pivots = (PyArrayObject *)PyArray_EMPTY(1, shape, NPY_INT, 0))) {
        npy_intp n_K = PyArray_SIZE(K), n_B = PyArray_SIZE(B);
        if (PyArray_SIZE(flat) != n_K + 2 * n_B || PyArray_SIZE(factors) != n_K + 2 * n_B ||
            !within_64(flat, PyArray_SIZE(lu) - 1))
            wrong("there must be a place in the band and a factor for each value");
        else {
            void *to = PyArray_DATA(lu), *exchanged = PyArray_DATA(pivots);
            if (type == NPY_DOUBLE)
                info = band_factor_real((gbtrf_t_real)routine, (int)n, (int)half, n_K, n_B,
                                        data_of(K), data_of(B), data_of(factors), data_of(flat),
                                        to, exchanged, &of_B);
            else
                info = band_factor_complex((gbtrf_t_complex)routine, (int)n, (int)half, n_K, n_B,
                                           data_of(K), data_of(B), data_of(factors),
                                           data_of(flat), to, exchanged, &of_B);
            result = Py_BuildValue("OOdi", lu, pivots, of_B, info);
        }
    }
    Py_XDECREF(K);
    Py_XDECREF(B);
    Py_XDECREF(factors);
    Py_XDECREF(flat);
    Py_XDECREF(lu);
    Py_XDECREF(pivots);
    return result;
}

/* Number and scale rows of right sides, and back. A complex row is two real ones where `parts` is
 * 2 and the matrix is real. */
static void numbered(npy_intp rows, npy_intp n, int parts, const npy_int64 *order,
                     const double *scale, const double *from, double *to, int back)
{
    for (npy_intp r = 0; r < rows; r++)
        for (int part = 0; part < parts; part++)
            for (npy_intp i = 0; i < n; i++) {
                npy_intp apart = (r * parts + part) * n + i;
                npy_intp together = (r * n + order[i]) * parts + part;
                if (back)
                    to[together] = scale[order[i]] * from[apart];
                else
                    to[apart] = scale[order[i]] * from[together];
            }
}

static void numbered_complex(npy_intp rows, npy_intp n, const npy_int64 *order,
                             const double *scale, const double complex *from, double complex *to,
                             int back)
{
    for (npy_intp r = 0; r < rows; r++)
        for (npy_intp i = 0; i < n; i++)
            if (back)
                to[r * n + order[i]] = scale[order[i]] * from[r * n + i];
            else
                to[r * n + i] = scale[order[i]] * from[r * n + order[i]];
}

/* A factorised band matrix and the routine that solves with it. */
typedef struct {
    PyArrayObject *lu, *pivots, *order, *scale;
    void *routine;
    npy_intp n, half;
    int is_complex;
} Band;

/* Take a band matrix from the first arguments of band_solve. */
static int band_taken(PyObject *const *args, Band *b)
{
    static void *routines[2];
    int type = is_complex(args[0]) ? NPY_CDOUBLE : NPY_DOUBLE;
    memset(b, 0, sizeof *b);
    b->is_complex = type == NPY_CDOUBLE;
    b->routine = lapack(&routines[b->is_complex], b->is_complex ? "zgbtrs" : "dgbtrs",
                        "void (char *, int *, int *, int *, int *, ");
    if (!b->routine || !taken(args[0], type, 2, &b->lu) ||
        !taken(args[1], NPY_INT, 0, &b->pivots) ||
        !taken_number(args[2], (INT_MAX - 1) / 3, &b->half) ||
        !taken(args[3], NPY_INT64, 0, &b->order) || !taken(args[4], NPY_DOUBLE, 0, &b->scale))
        return 0;
    b->n = PyArray_SIZE(b->order);
    npy_intp shape[] = {b->n, 3 * b->half + 1};
    return (b->n <= INT_MAX && PyArray_NDIM(b->lu) == 2 && ends_with(b->lu, 2, shape) &&
            PyArray_SIZE(b->pivots) == b->n && within_32(b->pivots, 1, b->n) &&
            within_64(b->order, b->n - 1) && PyArray_SIZE(b->scale) == b->n) ||
           wrong("factors, pivots, order and scale must be those of one band matrix");
}

static void band_dropped(Band *b)
{
    Py_XDECREF(b->lu);
    Py_XDECREF(b->pivots);
    Py_XDECREF(b->order);
    Py_XDECREF(b->scale);
}

/* Solve for rows of right sides; each is two of the matrix's type where `parts` is 2. */
static void solved(const Band *b, char how, npy_intp rows, int parts, const void *right,
                   void *work, void *out)
{
    const npy_int64 *order = data_of(b->order);
    const double *scale = data_of(b->scale);
    void *lu = PyArray_DATA(b->lu), *pivots = PyArray_DATA(b->pivots);
    int n = (int)b->n, half = (int)b->half;
    if (b->is_complex) {
        numbered_complex(rows, n, order, scale, right, work, 0);
        band_solve_complex((gbtrs_t_complex)b->routine, how, n, half, (int)rows, lu, pivots, work);
        numbered_complex(rows, n, order, scale, work, out, 1);
    } else {
        numbered(rows, n, parts, order, scale, right, work, 0);
        band_solve_real((gbtrs_t_real)b->routine, how, n, half, (int)rows * parts, lu, pivots,
                        work);
        numbered(rows, n, parts, order, scale, work, out, 1);
    }
}

/* band_solve(lu, pivots, half, order, scale, right, transposed): right sides are the last axis. */
static PyObject *py_band_solve(PyObject *const *args)
{
    Band b;
    PyArrayObject *right = NULL, *out = NULL;
    int type = is_complex(args[0]) || is_complex(args[5]) ? NPY_CDOUBLE : NPY_DOUBLE;
    int transposed = PyObject_IsTrue(args[6]);
    void *work = NULL;
    if (transposed < 0)
        return NULL;
    if (band_taken(args, &b) && taken(args[5], type, 1, &right)) {
        npy_intp rows = leading_size(right, 1);
        int parts = type == NPY_CDOUBLE && !b.is_complex ? 2 : 1;
        if (!ends_with(right, 1, &b.n) || rows > INT_MAX / 2)
            wrong("a right side must have one number for each row of the matrix");
        else if (!(work = PyMem_Malloc(PyArray_NBYTES(right) + 1)))
            PyErr_NoMemory();
        else if ((out = zeros_like(right, 0, 0, NULL, type)))
            solved(&b, transposed ? 'T' : 'N', rows, parts, data_of(right), work,
                   PyArray_DATA(out));
    }
    PyMem_Free(work);
    Py_XDECREF(right);
    band_dropped(&b);
    return (PyObject *)out;
}

/* An envelope (symmetric.h): where its columns begin, and how many numbers it has. */
typedef struct {
    PyArrayObject *first;
    npy_intp n, size;
} Envelope;

static int envelope_taken(PyObject *object, Envelope *e)
{
    if (!taken(object, NPY_INT32, 1, &e->first))
        return 0;
    const npy_int32 *first = PyArray_DATA(e->first);
    e->n = PyArray_SIZE(e->first) - 1;
    e->size = e->n < 0 ? 0 : first[e->n];
    int good = PyArray_NDIM(e->first) == 1 && e->n >= 0 && first[0] == 0;
    npy_int64 last = 0;
    for (npy_intp k = 0; good && k < e->n; k++) {
        npy_int64 height = (npy_int64)first[k + 1] - first[k], end = k + height;
        good = height >= 1 && end >= last && end <= e->n;
        last = end;
    }
    return good || wrong("columns of an envelope begin at their diagonal and end in order");
}

enum { MOST_TERMS = 3 };

/* Take terms (number, values) of a sum, all of one size. */
static int terms_taken(PyObject *terms, int type, int *count, double *s, PyArrayObject **K)
{
    if (!PyTuple_Check(terms) || PyTuple_Size(terms) < 1 || PyTuple_Size(terms) > MOST_TERMS)
        return wrong("a sum is a tuple of at most three terms");
    *count = (int)PyTuple_Size(terms);
    for (int i = 0; i < *count; i++) {
        PyObject *term = PyTuple_GetItem(terms, i);
        if (!PyTuple_Check(term) || PyTuple_Size(term) != 2)
            return wrong("a term is a number with values");
        s[i] = PyFloat_AsDouble(PyTuple_GetItem(term, 0));
        if (PyErr_Occurred() || !taken(PyTuple_GetItem(term, 1), type, 0, &K[i]))
            return 0;
        if (PyArray_SIZE(K[i]) != PyArray_SIZE(K[0]))
            return wrong("terms must have one size");
    }
    return 1;
}

static int terms_type(PyObject *terms)
{
    for (Py_ssize_t i = 0; PyTuple_Check(terms) && i < PyTuple_Size(terms); i++) {
        PyObject *term = PyTuple_GetItem(terms, i);
        if (PyTuple_Check(term) && PyTuple_Size(term) == 2 &&
            is_complex(PyTuple_GetItem(term, 1)))
            return NPY_CDOUBLE;
    }
    return NPY_DOUBLE;
}

/* ldl_factor(terms, B, chosen, places, first, signs): factors in their envelope, and the pivot
 * that fails. The numbers `chosen` of the values of K, a sum, then all of B, go to `places`. */
static PyObject *py_ldl_factor(PyObject *const *args)
{
    int type = is_complex(args[1]) ? NPY_CDOUBLE : terms_type(args[0]), count = 0, info;
    Envelope e = {NULL, 0, 0};
    PyArrayObject *K[MOST_TERMS] = {NULL}, *B = NULL, *chosen = NULL, *places = NULL;
    PyArrayObject *signs = NULL, *a = NULL;
    PyObject *result = NULL;
    double s[MOST_TERMS], *least = NULL;
    if (terms_taken(args[0], type, &count, s, K) && taken(args[1], type, 0, &B) &&
        taken(args[2], NPY_INT32, 1, &chosen) && taken(args[3], NPY_INT32, 1, &places) &&
        envelope_taken(args[4], &e) && taken(args[5], NPY_DOUBLE, 1, &signs) &&
        (a = (PyArrayObject *)PyArray_ZEROS(1, &e.size, type, 0))) {
        npy_intp n_K = PyArray_SIZE(chosen), n_B = PyArray_SIZE(B);
        if (PyArray_SIZE(places) != n_K + n_B || PyArray_SIZE(signs) != e.n ||
            !within_32(chosen, 0, PyArray_SIZE(K[0]) - 1) || !within_32(places, 0, e.size - 1))
            wrong("there must be a place in the envelope for each value, and a sign for each row");
        else if (!(least = PyMem_Malloc((size_t)e.n * sizeof(double) + 1)))
            PyErr_NoMemory();
        else {
            const npy_int32 *from = data_of(chosen), *to = data_of(places);
            void *own = PyArray_DATA(a);
            if (type == NPY_DOUBLE) {
                for (int i = 0; i < count; i++)
                    ldl_placed_real(n_K, from, to, s[i], data_of(K[i]), own);
                ldl_placed_real(n_B, NULL, to + n_K, 1, data_of(B), own);
                info = ldl_factor_real(e.n, data_of(e.first), data_of(signs), own, least);
            } else {
                for (int i = 0; i < count; i++)
                    ldl_placed_complex(n_K, from, to, s[i], data_of(K[i]), own);
                ldl_placed_complex(n_B, NULL, to + n_K, 1, data_of(B), own);
                info = ldl_factor_complex(e.n, data_of(e.first), data_of(signs), own, least);
            }
            result = Py_BuildValue("Oi", a, info);
        }
    }
    PyMem_Free(least);
    for (int i = 0; i < MOST_TERMS; i++)
        Py_XDECREF(K[i]);
    Py_XDECREF(B);
    Py_XDECREF(chosen);
    Py_XDECREF(places);
    Py_XDECREF(e.first);
    Py_XDECREF(signs);
    Py_XDECREF(a);
    return result;
}

/* ldl_solve(factors, first, order, right): right sides are the last axis. */
static PyObject *py_ldl_solve(PyObject *const *args)
{
    int own = is_complex(args[0]) ? NPY_CDOUBLE : NPY_DOUBLE;
    int type = own == NPY_CDOUBLE || is_complex(args[3]) ? NPY_CDOUBLE : NPY_DOUBLE;
    Envelope e = {NULL, 0, 0};
    PyArrayObject *a = NULL, *order = NULL, *right = NULL, *out = NULL;
    void *work = NULL;
    if (taken(args[0], own, 1, &a) && envelope_taken(args[1], &e) &&
        taken(args[2], NPY_INT64, 1, &order) && taken(args[3], type, 1, &right)) {
        int parts = type == own ? 1 : 2;
        npy_intp columns = leading_size(right, 1) * parts;
        if (PyArray_SIZE(a) != e.size || PyArray_SIZE(order) != e.n ||
            !within_64(order, e.n - 1) || !ends_with(right, 1, &e.n))
            wrong("factors, order and right sides must be those of one matrix");
        else if (!(work = PyMem_Malloc(8 * (size_t)e.n * sizeof(double complex) + 1)))
            PyErr_NoMemory();
        else if ((out = zeros_like(right, 0, 0, NULL, type))) {
            if (own == NPY_DOUBLE)
                ldl_solve_real(e.n, data_of(e.first), data_of(a), data_of(order), columns, parts,
                               data_of(right), work, PyArray_DATA(out));
            else
                ldl_solve_complex(e.n, data_of(e.first), data_of(a), data_of(order), columns,
                                  parts, data_of(right), work, PyArray_DATA(out));
        }
    }
    PyMem_Free(work);
    Py_XDECREF(a);
    Py_XDECREF(e.first);
    Py_XDECREF(order);
    Py_XDECREF(right);
    return (PyObject *)out;
}

/* ---- marches ------------------------------------------------------------------------------- */

#include "front_calls.h"
#include "prepared.h"
#include "stages.h"

/* ---- module -------------------------------------------------------------------------------- */

/* Each function takes exactly this many arguments; see `__init__.py`. */
#define FUNCTION(name, arguments)                                                                  \
    static PyObject *counted_##name(PyObject *self, PyObject *const *args, Py_ssize_t count)       \
    {                                                                                              \
        if (count != (arguments))                                                                  \
            return wrong(#name " takes " #arguments " arguments"), NULL;                           \
        (void)self;                                                                                \
        PyObject *found = py_##name(args);                                                         \
        if (found && PyErr_Occurred()) /* in a function that a list calls */                       \
            Py_CLEAR(found);                                                                       \
        return found;                                                                              \
    }
FUNCTION(add_scaled, 3)
FUNCTION(finite, 1)
FUNCTION(relative, 2)
FUNCTION(lifted, 2)
FUNCTION(forces, 3)
FUNCTION(forces_along, 5)
FUNCTION(force_totals, 9)
FUNCTION(force_partials, 11)
FUNCTION(tangents, 6)
FUNCTION(constraint_curvature, 3)
FUNCTION(constraint_totals, 8)
FUNCTION(list_values, 2)
FUNCTION(index_1_rows, 5)
FUNCTION(index_1_projected, 5)
FUNCTION(index_1_stages, 10)
FUNCTION(load_forces, 4)
FUNCTION(load_forces_along, 6)
FUNCTION(load_tangents, 5)
FUNCTION(gram, 2)
FUNCTION(strain, 4)
FUNCTION(stressed, 2)
FUNCTION(csr_rows, 4)
FUNCTION(csr_rows_transposed, 5)
FUNCTION(csr_subtract, 7)
FUNCTION(narrow_order, 4)
FUNCTION(recombine, 4)
FUNCTION(balance, 5)
FUNCTION(band_factor, 6)
FUNCTION(band_solve, 7)
FUNCTION(ldl_factor, 6)
FUNCTION(ldl_solve, 4)
FUNCTION(eliminate, 2)
FUNCTION(fronts_factor, 5)
FUNCTION(fronts_solve, 4)
FUNCTION(prepare, 3)
FUNCTION(march, 8)
FUNCTION(differentiate_steps, 6)
FUNCTION(pull_back_steps, 6)
FUNCTION(rest, 5)
FUNCTION(solve_stages, 9)

#define FUNCTION_OF_MANY(name)                                                                     \
    static PyObject *any_##name(PyObject *self, PyObject *const *args, Py_ssize_t count)           \
    {                                                                                              \
        (void)self;                                                                                \
        return py_##name(args, count);                                                             \
    }
FUNCTION_OF_MANY(norm)
FUNCTION_OF_MANY(constraints)
FUNCTION_OF_MANY(constraint_gradient)

#define METHOD(name) {#name, (PyCFunction)(void (*)(void))counted_##name, METH_FASTCALL, NULL}
#define METHOD_OF_MANY(name) {#name, (PyCFunction)(void (*)(void))any_##name, METH_FASTCALL, NULL}
static PyMethodDef methods[] = {
    METHOD(add_scaled),
    METHOD_OF_MANY(norm),
    METHOD_OF_MANY(constraints),
    METHOD_OF_MANY(constraint_gradient),
    METHOD(constraint_curvature),
    METHOD(constraint_totals),
    METHOD(list_values),
    METHOD(index_1_rows),
    METHOD(index_1_projected),
    METHOD(index_1_stages),
    METHOD(load_forces),
    METHOD(load_forces_along),
    METHOD(load_tangents),
    METHOD(finite),
    METHOD(relative),
    METHOD(lifted),
    METHOD(forces),
    METHOD(forces_along),
    METHOD(force_totals),
    METHOD(force_partials),
    METHOD(tangents),
    METHOD(gram),
    METHOD(strain),
    METHOD(stressed),
    METHOD(csr_rows),
    METHOD(csr_rows_transposed),
    METHOD(csr_subtract),
    METHOD(narrow_order),
    METHOD(recombine),
    METHOD(balance),
    METHOD(band_factor),
    METHOD(band_solve),
    METHOD(ldl_factor),
    METHOD(ldl_solve),
    METHOD(eliminate),
    METHOD(fronts_factor),
    METHOD(fronts_solve),
    METHOD(prepare),
    METHOD(march),
    METHOD(differentiate_steps),
    METHOD(pull_back_steps),
    METHOD(rest),
    METHOD(solve_stages),
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_kernels", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit__kernels(void)
{
    import_array();
    PyObject *module = PyModule_Create(&definition);
    ConstraintPlanType = (PyTypeObject *)PyType_FromSpec(&plan_type);
    LoadPlanType = (PyTypeObject *)PyType_FromSpec(&load_type);
    OperationListType = (PyTypeObject *)PyType_FromSpec(&list_type);
    if (module && (!ConstraintPlanType || !LoadPlanType || !OperationListType ||
                   PyModule_AddType(module, ConstraintPlanType) < 0 ||
                   PyModule_AddType(module, LoadPlanType) < 0 ||
                   PyModule_AddType(module, OperationListType) < 0))
        Py_CLEAR(module);
    return module;
}
