/* Fronts (`elimination.h`, `fronts.h`) as Python calls them; arrays are checked at each call. */

static PyArrayObject *new_numbers(npy_intp size, int type)
{
    return (PyArrayObject *)PyArray_SimpleNew(1, &size, type);
}

/* The analysis of a pattern, column by column from `down` on: rows below the diagonal. */
typedef struct {
    PyArrayObject *order, *begin, *row_at, *rows, *factor_at, *children;
    npy_intp stack, most;
    double work;
} Analysis;

/* Columns below the diagonal from rows left of it, in a new order; `down` has room for n + 2. */
static void turned_below(const elimination *x, npy_int64 *down, npy_int32 *below)
{
    memset(down, 0, (size_t)(x->n + 2) * sizeof *down);
    for (npy_intp i = 0; i < x->n; i++)
        for (npy_int64 e = x->first[i]; e < x->first[i + 1]; e++)
            down[x->place[x->columns[e]] + 2]++;
    for (npy_intp i = 0; i < x->n; i++)
        down[i + 2] += down[i + 1];
    for (npy_intp i = 0; i < x->n; i++)
        for (npy_int64 e = x->first[i]; e < x->first[i + 1]; e++)
            below[down[x->place[x->columns[e]] + 1]++] = x->place[i];
}

static int analysed(elimination *x, npy_int32 *room, double *zeros, npy_int64 *down,
                    npy_int32 *below, Analysis *a)
{
    npy_intp n = x->n, N;
    npy_int32 *begin = room, *size = begin + n + 1, *parent = size + n + 1, *count = parent + n;
    elimination_parents(x);
    elimination_counts(x);
    elimination_postorder(x);
    for (npy_intp i = 0; i < n; i++) {
        npy_int32 up = x->parent[x->post[i]];
        parent[i] = up < 0 ? -1 : x->place[up], count[i] = x->count[x->post[i]];
    }
    N = elimination_fronts(n, parent, count, begin, size, zeros);
    if (!(a->order = new_numbers(n, NPY_INT32)) || !(a->begin = new_numbers(N + 1, NPY_INT32)) ||
        !(a->row_at = new_numbers(N + 1, NPY_INT64)) ||
        !(a->factor_at = new_numbers(N + 1, NPY_INT64)) ||
        !(a->children = new_numbers(N, NPY_INT32)))
        return 0;
    npy_int64 *row_at = PyArray_DATA(a->row_at);
    row_at[0] = 0;
    for (npy_intp s = 0; s < N; s++)
        row_at[s + 1] = row_at[s] + size[s];
    if (!(a->rows = new_numbers(row_at[N], NPY_INT32)))
        return 0;
    memcpy(PyArray_DATA(a->order), x->post, (size_t)n * sizeof *begin);
    memcpy(PyArray_DATA(a->begin), begin, (size_t)(N + 1) * sizeof *begin);
    turned_below(x, down, below);
    a->work = elimination_rows(n, N, begin, down, below, row_at, PyArray_DATA(a->rows),
                               PyArray_DATA(a->factor_at), PyArray_DATA(a->children), x->mark,
                               x->place, x->head, &a->stack, &a->most);
    return 1;
}

/* eliminate(first, columns): the fronts of a symmetric matrix from its entries left of the
 * diagonal, row by row: (order, begin, row_at, rows, factor_at, children, stack, most), and the
 * multiplications of a factorisation. */
static PyObject *py_eliminate(PyObject *const *args)
{
    PyArrayObject *first = NULL, *columns = NULL;
    PyObject *result = NULL;
    Analysis a = {NULL, NULL, NULL, NULL, NULL, NULL, 0, 0, 0};
    void *room = NULL;
    if (taken(args[0], NPY_INT64, 1, &first) && taken(args[1], NPY_INT32, 1, &columns)) {
        npy_intp n = PyArray_SIZE(first) - 1, entries = PyArray_SIZE(columns);
        const npy_int64 *at = data_of(first);
        int good = n >= 0 && n < NPY_MAX_INT32 && at[0] == 0 && at[n] == entries;
        for (npy_intp i = 0; good && i < n; i++) {
            good = at[i] <= at[i + 1] && at[i + 1] <= entries;
            for (npy_int64 e = at[i]; good && e < at[i + 1]; e++) {
                npy_int32 j = ((const npy_int32 *)data_of(columns))[e];
                good = j >= 0 && j < i;
            }
        }
        size_t doubles = (size_t)n + 1, longs = (size_t)n + 2, ints = 15 * ((size_t)n + 1) + (size_t)entries;
        if (!good)
            wrong("entries must stand left of the diagonal, row by row");
        else if (!(room = PyMem_Malloc(8 * (doubles + longs) + 4 * ints)))
            PyErr_NoMemory();
        else {
            double *zeros = room;
            npy_int64 *down = (npy_int64 *)(zeros + doubles);
            npy_int32 *p = (npy_int32 *)(down + longs);
            size_t w = (size_t)n + 1;
            elimination x = {n, p, p + w, p + 2 * w, p + 3 * w, (npy_int64 *)at,
                             (npy_int32 *)data_of(columns), p + 4 * w, p + 5 * w, p + 7 * w};
            if (analysed(&x, p + 9 * w, zeros, down, p + 15 * w, &a))
                result = Py_BuildValue("(OOOOOOnn)d", a.order, a.begin, a.row_at, a.rows, a.factor_at,
                                       a.children, a.stack, a.most, a.work);
        }
    }
    PyMem_Free(room);
    Py_XDECREF(first);
    Py_XDECREF(columns);
    Py_XDECREF(a.order);
    Py_XDECREF(a.begin);
    Py_XDECREF(a.row_at);
    Py_XDECREF(a.rows);
    Py_XDECREF(a.factor_at);
    Py_XDECREF(a.children);
    return result;
}

/* (begin, row_at, rows, factor_at, children, stack, most, column_at, column_rows, signs) of a
 * matrix; the arrays are held in `own`. */
enum { FRONT_ARRAYS = 8, FRONT_ITEMS = 10 };

static int fronts_taken(PyObject *t, PyArrayObject **own, fronts *x)
{
    static const int place[] = {0, 1, 2, 3, 4, 7, 8, 9};
    static const int types[] = {NPY_INT32, NPY_INT64, NPY_INT32, NPY_INT64,
                                NPY_INT32, NPY_INT64, NPY_INT32, NPY_DOUBLE};
    for (int i = 0; i < FRONT_ARRAYS; i++)
        if (!item(t, FRONT_ITEMS, place[i]) ||
            !taken(item(t, FRONT_ITEMS, place[i]), types[i], 1, &own[i]))
            return PyErr_Occurred() ? 0 : wrong("fronts are ten arrays and numbers");
    npy_intp N = PyArray_SIZE(own[4]), n = PyArray_SIZE(own[7]);
    *x = (fronts){.n = n, .count = N, .begin = data_of(own[0]), .row_at = data_of(own[1]),
                  .rows = data_of(own[2]), .factor_at = data_of(own[3]),
                  .children = data_of(own[4]), .column_at = data_of(own[5]),
                  .column_rows = data_of(own[6]), .signs = data_of(own[7])};
    if (!taken_number(item(t, FRONT_ITEMS, 5), NPY_MAX_INT64, &x->stack) ||
        !taken_number(item(t, FRONT_ITEMS, 6), n, &x->most))
        return 0;
    int good = PyArray_SIZE(own[0]) == N + 1 && PyArray_SIZE(own[1]) == N + 1 &&
               PyArray_SIZE(own[3]) == N + 1 && PyArray_SIZE(own[5]) == n + 1 &&
               x->begin[0] == 0 && x->begin[N] == n && x->row_at[0] == 0 &&
               x->row_at[N] == PyArray_SIZE(own[2]) && x->factor_at[0] == 0 &&
               x->column_at[0] == 0 && x->column_at[n] == PyArray_SIZE(own[6]) &&
               within_32(own[2], 0, n - 1) && within_32(own[6], 0, n - 1);
    npy_intp waiting = 0, top = 0;
    npy_intp *updates = good ? PyMem_Malloc((size_t)(N + 1) * sizeof *updates) : NULL;
    if (good && !updates)
        return PyErr_NoMemory(), 0;
    for (npy_intp s = 0; good && s < N; s++) {
        npy_intp k = x->begin[s + 1] - x->begin[s], f = x->row_at[s + 1] - x->row_at[s], u = f - k;
        good = k > 0 && u >= 0 && f <= x->most && x->children[s] >= 0 &&
               x->children[s] <= waiting && x->factor_at[s + 1] == x->factor_at[s] + f * k &&
               top + u * u <= x->stack;
        for (npy_intp i = 0; good && i < k; i++)
            good = x->rows[x->row_at[s] + i] == x->begin[s] + i;
        for (npy_int32 c = 0; good && c < x->children[s]; c++)
            top -= updates[--waiting];
        if (good)
            top += updates[waiting++] = u * u;
    }
    PyMem_Free(updates);
    for (npy_intp j = 0; good && j < n; j++)
        good = x->column_at[j + 1] > x->column_at[j] && x->column_at[j + 1] <= x->column_at[n] &&
               x->column_rows[x->column_at[j]] == j;
    return good || wrong("these are no fronts of one matrix");
}

/* Whether rows of each front hold those of its columns and of the updates that it takes. */
static int fronts_closed(const fronts *x, npy_int32 *mark, npy_int32 *updates)
{
    npy_intp waiting = 0;
    for (npy_intp i = 0; i < x->n; i++)
        mark[i] = -1;
    for (npy_intp s = 0; s < x->count; s++) {
        for (npy_int64 e = x->row_at[s]; e < x->row_at[s + 1]; e++)
            mark[x->rows[e]] = (npy_int32)s;
        for (npy_int64 e = x->column_at[x->begin[s]]; e < x->column_at[x->begin[s + 1]]; e++)
            if (mark[x->column_rows[e]] != s)
                return 0;
        for (npy_int32 c = 0; c < x->children[s]; c++) {
            npy_intp own = updates[--waiting];
            npy_intp k = x->begin[own + 1] - x->begin[own];
            for (npy_int64 e = x->row_at[own] + k; e < x->row_at[own + 1]; e++)
                if (mark[x->rows[e]] != s)
                    return 0;
        }
        updates[waiting++] = (npy_int32)s;
    }
    return 1;
}

/* fronts_factor(terms, B, chosen, places, fronts): (scaled values, scale, factors), and the pivot
 * that fails. The numbers `chosen` of the values of K, a sum, then all of B, go to `places`. */
static PyObject *py_fronts_factor(PyObject *const *args)
{
    PyArrayObject *K[MOST_TERMS] = {NULL}, *B = NULL, *chosen = NULL, *places = NULL;
    PyArrayObject *own[FRONT_ARRAYS] = {NULL}, *out[3] = {NULL};
    PyObject *result = NULL;
    double s[MOST_TERMS];
    void *room = NULL;
    int count = 0;
    fronts x;
    if (terms_taken(args[0], NPY_DOUBLE, &count, s, K) && taken(args[1], NPY_DOUBLE, 0, &B) &&
        taken(args[2], NPY_INT32, 1, &chosen) && taken(args[3], NPY_INT32, 1, &places) &&
        fronts_taken(args[4], own, &x)) {
        npy_intp n_K = PyArray_SIZE(chosen), n_B = PyArray_SIZE(B), size = x.column_at[x.n];
        size_t doubles = (size_t)(size + x.stack + 5 * x.most), ints = 2 * (size_t)x.n + 1;
        if (PyArray_SIZE(places) != n_K + n_B || !within_32(places, 0, size - 1) ||
            !within_32(chosen, 0, PyArray_SIZE(K[0]) - 1))
            wrong("there must be a place in the matrix for each value");
        else if (!(room = PyMem_Malloc(8 * doubles + 4 * ints)) ||
                 !(out[0] = (PyArrayObject *)PyArray_ZEROS(1, &size, NPY_DOUBLE, 0)) ||
                 !(out[1] = new_numbers(x.n, NPY_DOUBLE)) ||
                 !(out[2] = new_numbers(x.factor_at[x.count], NPY_DOUBLE)))
            PyErr_NoMemory();
        else {
            double *a = PyArray_DATA(out[0]), *stack = (double *)room + size;
            npy_int32 *at = (npy_int32 *)((double *)room + doubles);
            front_room own_room = {a, PyArray_DATA(out[1]), room, stack, stack + x.stack, at};
            npy_intp info;
            if (!fronts_closed(&x, at, at + x.n))
                wrong("a front lacks rows");
            else {
                Py_BEGIN_ALLOW_THREADS
                for (int i = 0; i < count; i++)
                    ldl_placed_real(n_K, data_of(chosen), data_of(places), s[i], data_of(K[i]), a);
                ldl_placed_real(n_B, NULL, (const npy_int32 *)data_of(places) + n_K, 1, data_of(B), a);
                info = fronts_factored(&x, &own_room, PyArray_DATA(out[2]));
                Py_END_ALLOW_THREADS
                result = Py_BuildValue("(OOO)n", out[0], out[1], out[2], info);
            }
        }
    }
    PyMem_Free(room);
    for (int i = 0; i < MOST_TERMS; i++)
        Py_XDECREF(K[i]);
    for (int i = 0; i < FRONT_ARRAYS; i++)
        Py_XDECREF(own[i]);
    for (int i = 0; i < 3; i++)
        Py_XDECREF(out[i]);
    Py_XDECREF(B);
    Py_XDECREF(chosen);
    Py_XDECREF(places);
    return result;
}

/* fronts_solve(factored, fronts, order, right): solutions, and the largest relative residual;
 * right sides are the last axis. */
static PyObject *py_fronts_solve(PyObject *const *args)
{
    int type = is_complex(args[3]) ? NPY_CDOUBLE : NPY_DOUBLE;
    PyArrayObject *own[FRONT_ARRAYS] = {NULL}, *a[3] = {NULL}, *order = NULL, *right = NULL, *out = NULL;
    PyObject *result = NULL;
    double *work = NULL;
    fronts x;
    int good = fronts_taken(args[1], own, &x) && taken(args[2], NPY_INT64, 1, &order) &&
               taken(args[3], type, 1, &right);
    for (int i = 0; good && i < 3; i++)
        good = item(args[0], 3, i) ? taken(item(args[0], 3, i), NPY_DOUBLE, 1, &a[i])
                                   : wrong("factors are three arrays");
    if (good) {
        int parts = type == NPY_DOUBLE ? 1 : 2;
        npy_intp columns = leading_size(right, 1) * parts;
        if (PyArray_SIZE(a[0]) != x.column_at[x.n] || PyArray_SIZE(a[1]) != x.n ||
            PyArray_SIZE(a[2]) != x.factor_at[x.count] || PyArray_SIZE(order) != x.n ||
            !within_64(order, x.n - 1) || !ends_with(right, 1, &x.n))
            wrong("factors, order and right sides must be those of one matrix");
        else if (!(work = PyMem_Malloc((size_t)(12 * x.n + 4 * x.most + 1) * sizeof *work)))
            PyErr_NoMemory();
        else if ((out = zeros_like(right, 0, 0, NULL, type))) {
            double worst;
            Py_BEGIN_ALLOW_THREADS
            worst = fronts_solve(REFINED * DBL_EPSILON, &x, data_of(a[0]), data_of(a[2]), data_of(order), data_of(a[1]),
                                 columns, parts, data_of(right), work, PyArray_DATA(out));
            Py_END_ALLOW_THREADS
            result = Py_BuildValue("Od", out, worst);
        }
    }
    PyMem_Free(work);
    for (int i = 0; i < FRONT_ARRAYS; i++)
        Py_XDECREF(own[i]);
    for (int i = 0; i < 3; i++)
        Py_XDECREF(a[i]);
    Py_XDECREF(order);
    Py_XDECREF(right);
    Py_XDECREF(out);
    return result;
}
