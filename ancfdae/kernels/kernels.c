/* Inner loops of the package: element forces and tangents, sparse products, banded solutions.
 *
 * What they compute is said in `__init__.py`, and why in docs/theory.md. Every formula stands once,
 * in a header that is included for real and for complex numbers.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define NPY_TARGET_VERSION NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>

#include <complex.h>
#include <math.h>

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif
/* A second copy for processors with wide vectors, chosen when the module is loaded. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__gnu_linux__)
#define WITH_WIDE_VECTORS __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define WITH_WIDE_VECTORS
#endif

/* The largest element: 8 relative node vectors of 3 numbers. */
enum { MOST_Y = 8, MOST_G = 36, MOST_M = 24, MOST_WIDE = 32 };

#define T double
#define NAME(x) x##_real
#define CLONES WITH_WIDE_VECTORS
#include "elements.h"
#include "blocks.h"
#include "sparse.h"
#include "band.h"
#undef T
#undef NAME
#undef CLONES
#define T double complex
#define NAME(x) x##_complex
#define CLONES
#include "elements.h"
#include "blocks.h"
#include "sparse.h"
#include "band.h"
#undef T
#undef NAME
#undef CLONES

/* ---- arguments ---------------------------------------------------------------------------- */

/* An array of a type, in one piece; NULL stays NULL, and None becomes it. */
static int taken(PyObject *object, int type, PyArrayObject **array)
{
    *array = NULL;
    if (object == NULL || object == Py_None)
        return 1;
    *array = (PyArrayObject *)PyArray_FROM_OTF(object, type, NPY_ARRAY_IN_ARRAY);
    return *array != NULL;
}

static int is_complex(PyObject *object)
{
    return object != NULL && PyArray_Check(object) &&
           PyArray_ISCOMPLEX((PyArrayObject *)object);
}

static int wrong(const char *what)
{
    PyErr_SetString(PyExc_ValueError, what);
    return 0;
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

/* ---- blocks of elements -------------------------------------------------------------------- */

enum { BLOCK_ITEMS = 7, MOST_STATES = 5 };

/* A block (A, g_o, p_o, tau, vectors, d, n_q) with states, all of one type. */
typedef struct {
    PyArrayObject *A, *g_o, *p_o, *tau, *vectors, *states[MOST_STATES];
    int n_y, d, type;
    npy_intp n, n_q;
} Arguments;

static void dropped(Arguments *a)
{
    Py_XDECREF(a->A);
    Py_XDECREF(a->g_o);
    Py_XDECREF(a->p_o);
    Py_XDECREF(a->tau);
    Py_XDECREF(a->vectors);
    for (int i = 0; i < MOST_STATES; i++)
        Py_XDECREF(a->states[i]);
}

static int filled(Arguments *a, PyObject *block, PyObject *const *states, int count)
{
    memset(a, 0, sizeof *a);
    if (!PyTuple_Check(block) || PyTuple_GET_SIZE(block) != BLOCK_ITEMS)
        return wrong("a block is (A, g_o, p_o, tau, vectors, d, n_q)");
    PyObject *items[BLOCK_ITEMS];
    a->type = NPY_DOUBLE;
    for (int i = 0; i < BLOCK_ITEMS; i++)
        items[i] = PyTuple_GET_ITEM(block, i);
    for (int i = 0; i < 4; i++)
        if (is_complex(items[i]))
            a->type = NPY_CDOUBLE;
    for (int i = 0; i < count; i++)
        if (is_complex(states[i]))
            a->type = NPY_CDOUBLE;
    if (!taken(items[0], a->type, &a->A) || !taken(items[1], a->type, &a->g_o) ||
        !taken(items[2], a->type, &a->p_o) || !taken(items[3], a->type, &a->tau) ||
        !taken(items[4], NPY_INT64, &a->vectors))
        return 0;
    for (int i = 0; i < count; i++)
        if (!taken(states[i], a->type, &a->states[i]))
            return 0;
    a->d = (int)PyLong_AsLong(items[5]);
    a->n_q = PyLong_AsSsize_t(items[6]);
    if (PyErr_Occurred())
        return 0;
    if (PyArray_NDIM(a->vectors) != 2)
        return wrong("vectors must have two axes");
    a->n = PyArray_DIM(a->vectors, 0);
    a->n_y = (int)PyArray_DIM(a->vectors, 1) - 1;
    if (a->n_y < 1 || a->n_y > MOST_Y || a->d < 1 || a->d > 3)
        return wrong("an element has at most 8 relative node vectors of 3 numbers");
    return 1;
}

/* Whether the states have n_q numbers in their last axis, where there are any. */
static int fitting(const Arguments *a, int count)
{
    for (int i = 0; i < count; i++) {
        PyArrayObject *x = a->states[i];
        if (x && PyArray_DIM(x, PyArray_NDIM(x) - 1) != a->n_q)
            return wrong("states must have n_q numbers");
    }
    return 1;
}

/* Run f for the type of the arguments, at k instants. */
#define BLOCK_OF_TYPE(kind)                                                                        \
    block_##kind b = {a.n,                                                                         \
                      a.n_q,                                                                       \
                      a.A && PyArray_DIM(a.A, 0) == 1,                                             \
                      k,                                                                           \
                      data_of(a.vectors),                                                          \
                      data_of(a.A),                                                                \
                      data_of(a.g_o),                                                              \
                      data_of(a.p_o),                                                              \
                      data_of(a.tau)};
#define FOR_TYPE(f, ...)                                                                           \
    do {                                                                                           \
        if (a.type == NPY_DOUBLE) {                                                                \
            BLOCK_OF_TYPE(real)                                                                    \
            f##_real(a.n_y, a.d, &b, __VA_ARGS__);                                                 \
        } else {                                                                                   \
            BLOCK_OF_TYPE(complex)                                                                 \
            f##_complex(a.n_y, a.d, &b, __VA_ARGS__);                                              \
        }                                                                                          \
    } while (0)

static PyObject *py_relative(PyObject *self, PyObject *const *args, Py_ssize_t count)
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

static PyObject *py_lifted(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Arguments a;
    PyArrayObject *out = NULL;
    if (filled(&a, args[0], args + 1, 1)) {
        npy_intp k = leading_size(a.states[0], 3);
        out = zeros_like(a.states[0], 3, 1, &a.n_q, a.type);
        if (out)
            FOR_TYPE(lifted, data_of(a.states[0]), PyArray_DATA(out));
    }
    dropped(&a);
    return (PyObject *)out;
}

static PyObject *py_forces(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Arguments a;
    PyArrayObject *out = NULL;
    if (filled(&a, args[0], args + 1, 2) && fitting(&a, 2)) {
        npy_intp k = leading_size(a.states[0], 1);
        out = zeros_like(a.states[0], 1, 1, &a.n_q, a.type);
        if (out)
            FOR_TYPE(forces, data_of(a.states[0]), data_of(a.states[1]), PyArray_DATA(out));
    }
    dropped(&a);
    return (PyObject *)out;
}

static PyObject *py_forces_along(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Arguments a;
    PyArrayObject *out = NULL;
    if (filled(&a, args[0], args + 1, 5) && fitting(&a, 4)) {
        npy_intp k = leading_size(a.states[2], 1);
        out = zeros_like(a.states[2], 1, 1, &a.n_q, a.type);
        if (out)
            FOR_TYPE(forces_along, leading_size(a.states[0], 1) == 1, data_of(a.states[0]), data_of(a.states[1]),
                     data_of(a.states[2]), data_of(a.states[3]), data_of(a.states[4]),
                     PyArray_DATA(out));
    }
    dropped(&a);
    return (PyObject *)out;
}

static PyObject *py_tangents(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Arguments a;
    PyArrayObject *out = NULL, *index = NULL;
    int damping = PyObject_IsTrue(args[3]);
    npy_intp nnz = PyLong_AsSsize_t(args[5]);
    if (filled(&a, args[0], args + 1, 2) && fitting(&a, 2) &&
        taken(args[4], NPY_INT32, &index) && !PyErr_Occurred()) {
        npy_intp k = leading_size(a.states[0], 1);
        out = zeros_like(a.states[0], 1, 1, &nnz, a.type);
        if (out)
            FOR_TYPE(tangents, data_of(a.states[0]), data_of(a.states[1]), damping,
                     data_of(index), nnz, PyArray_DATA(out));
    }
    Py_XDECREF(index);
    dropped(&a);
    return (PyObject *)out;
}

/* ---- packed matrices ----------------------------------------------------------------------- */

/* gram(Y, U), and strain(g_o, tau, Y, V) where all four are given; Y has shape (..., n, n_y, d). */
static PyObject *packed(PyObject *g_o, PyObject *tau, PyObject *Y, PyObject *U)
{
    Arguments a;
    PyArrayObject *out = NULL;
    PyObject *items[] = {Y, U};
    memset(&a, 0, sizeof a);
    a.type = is_complex(g_o) || is_complex(tau) || is_complex(Y) || is_complex(U) ? NPY_CDOUBLE
                                                                                  : NPY_DOUBLE;
    if (taken(items[0], a.type, &a.states[0]) && taken(items[1], a.type, &a.states[1]) &&
        taken(g_o, a.type, &a.g_o) && taken(tau, a.type, &a.tau)) {
        int axes = PyArray_NDIM(a.states[0]);
        a.n_y = (int)PyArray_DIM(a.states[0], axes - 2);
        a.d = (int)PyArray_DIM(a.states[0], axes - 1);
        a.n = axes > 2 ? PyArray_DIM(a.states[0], axes - 3) : 1;
        npy_intp k = a.n ? leading_size(a.states[0], 2) / a.n : 0;
        npy_intp n_g = (npy_intp)a.n_y * (a.n_y + 1) / 2;
        if (a.n_y > MOST_Y || (a.states[1] && !PyArray_SAMESHAPE(a.states[0], a.states[1])))
            wrong("node vectors must have one shape, and be at most 8");
        else
            out = zeros_like(a.states[0], 2, 1, &n_g, a.type);
        if (out)
            FOR_TYPE(packed, a.g_o && PyArray_DIM(a.g_o, 0) == 1, data_of(a.states[0]),
                     data_of(a.states[1]), PyArray_DATA(out));
    }
    dropped(&a);
    return (PyObject *)out;
}

static PyObject *py_gram(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return packed(NULL, NULL, args[0], args[1]);
}

static PyObject *py_strain(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return packed(args[0], args[3], args[1], args[2]);
}

static PyObject *py_stressed(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    int type = is_complex(args[0]) || is_complex(args[1]) ? NPY_CDOUBLE : NPY_DOUBLE;
    PyArrayObject *p = NULL, *Y = NULL, *out = NULL;
    if (taken(args[0], type, &p) && taken(args[1], type, &Y)) {
        int axes = PyArray_NDIM(Y), n_y = (int)PyArray_DIM(Y, axes - 2);
        int d = (int)PyArray_DIM(Y, axes - 1);
        npy_intp n = leading_size(Y, 2);
        if (n_y > MOST_Y || leading_size(p, 1) != n)
            wrong("there must be one p for each set of node vectors");
        else
            out = zeros_like(Y, 0, 0, NULL, type);
        if (out && type == NPY_DOUBLE)
            stressed_each_real(n_y, d, n, data_of(p), data_of(Y), PyArray_DATA(out));
        else if (out)
            stressed_each_complex(n_y, d, n, data_of(p), data_of(Y), PyArray_DATA(out));
    }
    Py_XDECREF(p);
    Py_XDECREF(Y);
    return (PyObject *)out;
}

/* ---- linear algebra ------------------------------------------------------------------------ */

/* Rows of x times the matrix (transposed) or its transpose; the last axis then has `size` numbers. */
static PyObject *csr(PyObject *const *args, npy_intp size, int transposed)
{
    int type = is_complex(args[2]) || is_complex(args[3]) ? NPY_CDOUBLE : NPY_DOUBLE;
    PyArrayObject *first = NULL, *columns = NULL, *values = NULL, *x = NULL, *out = NULL;
    if (taken(args[0], NPY_INT32, &first) && taken(args[1], NPY_INT32, &columns) &&
        taken(args[2], type, &values) && taken(args[3], type, &x)) {
        npy_intp k = leading_size(x, 1), n = PyArray_SIZE(first) - 1;
        npy_intp width = PyArray_DIM(x, PyArray_NDIM(x) - 1);
        if (transposed && width != n)
            wrong("x must have one number for each row of the matrix");
        else
            out = zeros_like(x, 1, 1, transposed ? &size : &n, type);
        if (out && type == NPY_DOUBLE)
            (transposed ? csr_rows_transposed_real : csr_rows_real)(
                n, data_of(first), data_of(columns), data_of(values), k, transposed ? size : width,
                data_of(x), PyArray_DATA(out));
        else if (out)
            (transposed ? csr_rows_transposed_complex : csr_rows_complex)(
                n, data_of(first), data_of(columns), data_of(values), k, transposed ? size : width,
                data_of(x), PyArray_DATA(out));
    }
    Py_XDECREF(first);
    Py_XDECREF(columns);
    Py_XDECREF(values);
    Py_XDECREF(x);
    return (PyObject *)out;
}

static PyObject *py_csr_rows(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return csr(args, 0, 0);
}

static PyObject *py_csr_rows_transposed(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return csr(args, PyLong_AsSsize_t(args[4]), 1);
}

/* norm(x, weights): sqrt(sum(weights x^2)) of the real part. */
static PyObject *py_norm(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    int stride = is_complex(args[0]) ? 2 : 1;
    PyArrayObject *x = NULL, *weights = NULL;
    PyObject *result = NULL;
    if (taken(args[0], stride == 2 ? NPY_CDOUBLE : NPY_DOUBLE, &x) &&
        taken(args[1], NPY_DOUBLE, &weights)) {
        const double *from = data_of(x), *w = data_of(weights);
        double sum = 0;
        if (PyArray_SIZE(x) != PyArray_SIZE(weights))
            wrong("there must be one weight for each number");
        else {
            for (npy_intp i = 0; i < PyArray_SIZE(x); i++)
                sum += w[i] * from[i * stride] * from[i * stride];
            result = PyFloat_FromDouble(sqrt(sum));
        }
    }
    Py_XDECREF(x);
    Py_XDECREF(weights);
    return result;
}

/* add_scaled(x, s, y): x + s y; NumPy's own operators where these are not real arrays alike. */
static PyObject *py_add_scaled(PyObject *self, PyObject *const *args, Py_ssize_t count)
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
        const double *from = data_of(x), *added = data_of(y), s = PyFloat_AS_DOUBLE(args[1]);
        double *to = PyArray_DATA(out);
        for (npy_intp i = 0; i < PyArray_SIZE(x); i++)
            to[i] = from[i] + s * added[i];
    }
    return (PyObject *)out;
}

/* finite(x): whether every number is. */
static PyObject *py_finite(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    int is_c = is_complex(args[0]);
    PyArrayObject *x = NULL;
    if (!taken(args[0], is_c ? NPY_CDOUBLE : NPY_DOUBLE, &x))
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

/* A LAPACK routine of SciPy for 32-bit integers. */
static void *lapack(const char *name)
{
    void *found = NULL;
    PyObject *module = PyImport_ImportModule("scipy.linalg.cython_lapack");
    PyObject *routines = module ? PyObject_GetAttrString(module, "__pyx_capi__") : NULL;
    PyObject *capsule = routines ? PyDict_GetItemString(routines, name) : NULL;
    if (capsule)
        found = PyCapsule_GetPointer(capsule, PyCapsule_GetName(capsule));
    else if (!PyErr_Occurred())
        PyErr_Format(PyExc_ImportError, "SciPy has no routine %s", name);
    Py_XDECREF(routines);
    Py_XDECREF(module);
    return found;
}

/* band_factor(K, B, factors, flat, n, half): the factors, (n, 3 half + 1), pivots, and info. */
static PyObject *py_band_factor(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    static void *routines[2];
    int type = is_complex(args[0]) || is_complex(args[1]) ? NPY_CDOUBLE : NPY_DOUBLE, info = 0;
    npy_intp n = PyLong_AsSsize_t(args[4]), half = PyLong_AsSsize_t(args[5]);
    npy_intp shape[] = {n, 3 * half + 1};
    PyArrayObject *K = NULL, *B = NULL, *factors = NULL, *flat = NULL, *lu = NULL, *pivots = NULL;
    PyObject *result = NULL;
    void **routine = &routines[type == NPY_CDOUBLE];
    if (!*routine)
        *routine = lapack(type == NPY_CDOUBLE ? "zgbtrf" : "dgbtrf");
    if (*routine && !PyErr_Occurred() && taken(args[0], type, &K) && taken(args[1], type, &B) &&
        taken(args[2], NPY_DOUBLE, &factors) && taken(args[3], NPY_INT64, &flat) &&
        (lu = (PyArrayObject *)PyArray_ZEROS(2, shape, type, 0)) &&
        (pivots = (PyArrayObject *)PyArray_EMPTY(1, shape, NPY_INT, 0))) {
        npy_intp n_K = PyArray_SIZE(K), n_B = PyArray_SIZE(B);
        if (PyArray_SIZE(flat) != n_K + 2 * n_B || PyArray_SIZE(factors) != n_K + 2 * n_B)
            wrong("there must be a place and a factor for each value");
        else {
            if (type == NPY_DOUBLE)
                info = band_factor_real((gbtrf_t_real)*routine, (int)n, (int)half, n_K, n_B,
                                        data_of(K), data_of(B), data_of(factors), data_of(flat),
                                        PyArray_DATA(lu), PyArray_DATA(pivots));
            else
                info = band_factor_complex((gbtrf_t_complex)*routine, (int)n, (int)half, n_K, n_B,
                                           data_of(K), data_of(B), data_of(factors), data_of(flat),
                                           PyArray_DATA(lu), PyArray_DATA(pivots));
            result = Py_BuildValue("OOi", lu, pivots, info);
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

/* band_solve(lu, pivots, half, order, scale, right, transposed): right sides are the last axis. */
static PyObject *py_band_solve(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    static void *routines[2];
    int complex_matrix = is_complex(args[0]), type = complex_matrix ? NPY_CDOUBLE : NPY_DOUBLE;
    int right_type = complex_matrix || is_complex(args[5]) ? NPY_CDOUBLE : NPY_DOUBLE;
    int half = (int)PyLong_AsLong(args[2]), transposed = PyObject_IsTrue(args[6]);
    PyArrayObject *lu = NULL, *pivots = NULL, *order = NULL, *scale = NULL, *right = NULL;
    PyArrayObject *out = NULL;
    void **routine = &routines[complex_matrix], *work = NULL;
    if (!*routine)
        *routine = lapack(complex_matrix ? "zgbtrs" : "dgbtrs");
    if (*routine && !PyErr_Occurred() && taken(args[0], type, &lu) &&
        taken(args[1], NPY_INT, &pivots) && taken(args[3], NPY_INT64, &order) &&
        taken(args[4], NPY_DOUBLE, &scale) && taken(args[5], right_type, &right)) {
        npy_intp n = PyArray_SIZE(order), rows = leading_size(right, 1);
        int parts = right_type == NPY_CDOUBLE && !complex_matrix ? 2 : 1;
        char how = transposed ? 'T' : 'N';
        if (PyArray_DIM(right, PyArray_NDIM(right) - 1) != n)
            wrong("a right side must have one number for each row of the matrix");
        else if ((out = zeros_like(right, 0, 0, NULL, right_type)) &&
                 (work = PyMem_Malloc(PyArray_NBYTES(out) + 1))) {
            if (complex_matrix) {
                numbered_complex(rows, n, data_of(order), data_of(scale), data_of(right), work, 0);
                band_solve_complex((gbtrs_t_complex)*routine, how, (int)n, half, (int)rows,
                                   PyArray_DATA(lu), PyArray_DATA(pivots), work);
                numbered_complex(rows, n, data_of(order), data_of(scale), work, PyArray_DATA(out),
                                 1);
            } else {
                numbered(rows, n, parts, data_of(order), data_of(scale), data_of(right), work, 0);
                band_solve_real((gbtrs_t_real)*routine, how, (int)n, half, (int)rows * parts,
                                PyArray_DATA(lu), PyArray_DATA(pivots), work);
                numbered(rows, n, parts, data_of(order), data_of(scale), work, PyArray_DATA(out),
                         1);
            }
            PyMem_Free(work);
        }
    }
    Py_XDECREF(lu);
    Py_XDECREF(pivots);
    Py_XDECREF(order);
    Py_XDECREF(scale);
    Py_XDECREF(right);
    return (PyObject *)out;
}

/* ---- module -------------------------------------------------------------------------------- */

/* Each function takes exactly this many arguments; see `__init__.py`. */
#define FUNCTION(name, arguments)                                                                  \
    static PyObject *counted_##name(PyObject *self, PyObject *const *args, Py_ssize_t count)       \
    {                                                                                              \
        if (count != (arguments))                                                                  \
            return wrong(#name " takes " #arguments " arguments"), NULL;                           \
        return py_##name(self, args, count);                                                       \
    }
FUNCTION(add_scaled, 3)
FUNCTION(finite, 1)
FUNCTION(relative, 2)
FUNCTION(lifted, 2)
FUNCTION(forces, 3)
FUNCTION(forces_along, 6)
FUNCTION(tangents, 6)
FUNCTION(gram, 2)
FUNCTION(strain, 4)
FUNCTION(stressed, 2)
FUNCTION(csr_rows, 4)
FUNCTION(csr_rows_transposed, 5)
FUNCTION(norm, 2)
FUNCTION(band_factor, 6)
FUNCTION(band_solve, 7)

#define METHOD(name) {#name, (PyCFunction)(void (*)(void))counted_##name, METH_FASTCALL, NULL}
static PyMethodDef methods[] = {
    METHOD(add_scaled),
    METHOD(finite),
    METHOD(relative),
    METHOD(lifted),
    METHOD(forces),
    METHOD(forces_along),
    METHOD(tangents),
    METHOD(gram),
    METHOD(strain),
    METHOD(stressed),
    METHOD(csr_rows),
    METHOD(csr_rows_transposed),
    METHOD(norm),
    METHOD(band_factor),
    METHOD(band_solve),
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_kernels", .m_size = -1, .m_methods = methods};

PyMODINIT_FUNC PyInit__kernels(void)
{
    import_array();
    return PyModule_Create(&definition);
}
