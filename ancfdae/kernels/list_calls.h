/* What Python calls of formulas: a list of operations, made once, and its values. */

enum { LIST_INDICES = 5 };

/* Indices in the order of `operation_list`, and constants, real and complex. */
typedef struct {
    PyObject_HEAD
    PyObject *arguments; /* hold the functions */
    PyArrayObject *indices[LIST_INDICES], *constants[2];
    operation_list list;
} OperationList;

static void list_dropped(OperationList *self)
{
    Py_XDECREF(self->arguments);
    for (int i = 0; i < LIST_INDICES; i++)
        Py_XDECREF(self->indices[i]);
    for (int i = 0; i < 2; i++)
        Py_XDECREF(self->constants[i]);
    PyTypeObject *type = Py_TYPE((PyObject *)self);
    PyObject_Free(self);
    Py_DECREF(type);
}

/* Whether operation k is a call of a function that there is, of numbers before it. */
static int call_fits(const operation_list *p, npy_intp k, npy_intp size)
{
    npy_intp at = p->a[k], own = p->n_inputs + p->n_constants + k;
    if (at < 0 || at + 2 > size || p->b[k] < 0 || p->b[k] >= PyTuple_Size(p->functions))
        return 0;
    const npy_int32 *call = p->calls + at, *in = call + 2;
    if (call[0] < 0 || call[1] < 0 || (npy_intp)call[0] + call[1] > size - at - 2)
        return 0;
    for (npy_intp j = 0; j < call[0]; j++)
        if (in[j] < 0 || in[j] >= own)
            return 0;
    for (npy_intp j = call[0]; j < (npy_intp)call[0] + call[1]; j++) {
        npy_intp to = in[j] - own + k;
        if (in[j] != -1 && (to <= k || to >= p->n_operations || p->op[to] != RESULT || p->a[to] != own))
            return 0;
    }
    return 1;
}

static int list_fits(const OperationList *self)
{
    const operation_list *p = &self->list;
    PyArrayObject *const *x = self->indices;
    npy_intp ahead = p->n_inputs + p->n_constants;
    int good = within_32(x[0], 0, LIST_OPERATIONS - 1) && PyArray_SIZE(x[1]) == p->n_operations &&
               PyArray_SIZE(x[2]) == p->n_operations &&
               (p->n_outputs == 0 || (p->n_numbers > 0 && within_32(x[3], 0, p->n_numbers - 1)));
    for (npy_intp k = 0; good && k < p->n_operations; k++)
        good = p->op[k] == CALL ? call_fits(p, k, PyArray_SIZE(x[4]))
                                : p->a[k] >= 0 && p->a[k] < ahead + k && p->b[k] >= 0 &&
                                      p->b[k] < ahead + k;
    return good || wrong("these are not the indices of a list of operations");
}

/* Calls the function of operation k, with rows of inputs, (lanes, n), for rows of its outputs. Where
 * it raises, or something has been raised already, outputs are NaN; the caller's caller looks. */
static void list_called(const operation_list *p, npy_intp k, npy_intp lanes, int type,
                        void *numbers)
{
    const npy_int32 *call = p->calls + p->a[k], *in = call + 2, *to = in + call[0];
    npy_intp n = call[0], m = call[1], shape[] = {lanes, n}, of_found[] = {lanes, m};
    npy_intp size = type == NPY_DOUBLE ? sizeof(double) : 2 * sizeof(double);
    PyArrayObject *found = NULL;
    PyGILState_STATE state = PyGILState_Ensure(); /* marches run without it */
    PyObject *given = PyErr_Occurred() ? NULL : PyArray_SimpleNew(2, shape, type), *result = NULL;
    char *x = numbers, *rows = given ? PyArray_DATA((PyArrayObject *)given) : NULL;
    if (rows) {
        for (npy_intp j = 0; j < n; j++)
            for (npy_intp i = 0; i < lanes; i++)
                memcpy(rows + (i * n + j) * size, x + (in[j] * lanes + i) * size, (size_t)size);
        PyObject *function = PyTuple_GetItem(p->functions, p->b[k]);
        result = PyObject_CallFunctionObjArgs(function, given, NULL);
    }
    int good = result && taken(result, type, 2, &found) && PyArray_NDIM(found) == 2 &&
               ends_with(found, 2, of_found);
    if (!good && !PyErr_Occurred())
        wrong("a function of a list returns an array of another shape");
    for (npy_intp j = 0; j < m; j++)
        for (npy_intp i = 0; to[j] >= 0 && i < lanes; i++) {
            char *y = x + (to[j] * lanes + i) * size;
            if (good)
                memcpy(y, (char *)PyArray_DATA(found) + (i * m + j) * size, (size_t)size);
            else
                memset(y, 0xff, (size_t)size); /* NaN */
        }
    Py_XDECREF(given);
    Py_XDECREF(result);
    Py_XDECREF(found);
    PyGILState_Release(state);
}

/* OperationList(n_inputs, constants, op, a, b, outputs, calls, functions) */
static int list_filled(OperationList *self, PyObject *arguments)
{
    PyObject *constants, *indices[LIST_INDICES];
    Py_ssize_t n_inputs;
    operation_list *p = &self->list;
    const npy_int32 **to[] = {&p->op, &p->a, &p->b, &p->outputs, &p->calls};
    if (!PyArg_ParseTuple(arguments, "nOOOOOOO!", &n_inputs, &constants, indices, indices + 1,
                          indices + 2, indices + 3, indices + 4, &PyTuple_Type, &p->functions))
        return 0;
    if (n_inputs < 0 || n_inputs > NPY_MAX_INT32)
        return wrong("a number of inputs is negative or too large");
    for (int i = 0; i < LIST_INDICES; i++) {
        if (!taken(indices[i], NPY_INT32, 1, &self->indices[i]))
            return 0;
        *to[i] = data_of(self->indices[i]);
    }
    if (!taken(constants, NPY_DOUBLE, 1, &self->constants[0]) ||
        !taken(constants, NPY_CDOUBLE, 1, &self->constants[1]))
        return 0;
    p->n_inputs = n_inputs, p->n_constants = PyArray_SIZE(self->constants[0]);
    p->n_operations = PyArray_SIZE(self->indices[0]);
    p->n_outputs = PyArray_SIZE(self->indices[3]);
    p->n_numbers = p->n_inputs + p->n_constants + p->n_operations;
    return list_fits(self);
}

static PyObject *list_new(PyTypeObject *type, PyObject *arguments, PyObject *names)
{
    OperationList *self = (OperationList *)PyType_GenericAlloc(type, 0);
    if (!self)
        return NULL;
    self->arguments = Py_NewRef(arguments);
    if ((names && PyDict_Size(names) > 0 && !wrong("a list takes no names")) ||
        !list_filled(self, arguments))
        Py_CLEAR(self);
    return (PyObject *)self;
}

static PyObject *list_reduced(PyObject *self, PyObject *none)
{
    (void)none;
    return Py_BuildValue("(OO)", Py_TYPE(self), ((OperationList *)self)->arguments);
}

static PyMethodDef list_methods[] = {{"__reduce__", list_reduced, METH_NOARGS, NULL},
                                     {NULL, NULL, 0, NULL}};
static PyType_Slot list_slots[] = {{Py_tp_dealloc, (void *)list_dropped},
                                   {Py_tp_methods, list_methods},
                                   {Py_tp_new, (void *)list_new},
                                   {0, NULL}};
static PyType_Spec list_type = {
    .name = "ancfdae.kernels._kernels.OperationList",
    .basicsize = sizeof(OperationList),
    .flags = Py_TPFLAGS_DEFAULT,
    .slots = list_slots,
};
static PyTypeObject *OperationListType; /* Made when the module is imported. */

/* list_values(list, inputs) */
static PyObject *py_list_values(PyObject *const *args)
{
    PyArrayObject *x = NULL, *out = NULL;
    int type = is_complex(args[1]) ? NPY_CDOUBLE : NPY_DOUBLE;
    if (!PyObject_TypeCheck(args[0], OperationListType))
        return wrong("the first argument must be a list of operations"), NULL;
    const OperationList *of = (const OperationList *)args[0];
    const operation_list *p = &of->list;
    if (taken(args[1], type, 1, &x) &&
        (ends_with(x, 1, &p->n_inputs) || wrong("there must be a number for each input"))) {
        void *work = PyMem_Malloc((size_t)p->n_numbers * LIST_LANES * 16 + 1);
        npy_intp k = leading_size(x, 1);
        out = work ? zeros_like(x, 1, 1, &p->n_outputs, type) : (PyErr_NoMemory(), NULL);
        if (out && type == NPY_DOUBLE)
            list_values_real(p, data_of(of->constants[0]), k, data_of(x), work, PyArray_DATA(out));
        else if (out)
            list_values_complex(p, data_of(of->constants[1]), k, data_of(x), work,
                                PyArray_DATA(out));
        PyMem_Free(work);
    }
    Py_XDECREF(x);
    return (PyObject *)out;
}

/* ---- accelerations from lists (index_1.h) --------------------------------------------------- */

/* A system with the arrays that it points to. */
typedef struct {
    index_1 system;
    PyArrayObject *b, *scale, *t;
    void *memory;
} Index1;

static void index_1_dropped(Index1 *x)
{
    Py_XDECREF(x->b);
    Py_XDECREF(x->scale);
    Py_XDECREF(x->t);
    PyMem_Free(x->memory);
}

/* (lists, b, scale, t), and `shape`, the last axes of states: 2, 1 or 1 + n_b, n. */
static int index_1_taken(Index1 *x, PyObject *const *args, const npy_intp *shape)
{
    static const int values[] = {MATRIX, PLACE, SPEED}, changes[] = {SIDES, PLACES, SPEEDS};
    index_1 *s = &x->system;
    for (int i = 0; i < INDEX_1_LISTS; i++) {
        PyObject *list = item(args[0], INDEX_1_LISTS, i);
        if (!list)
            return 0;
        if (!PyObject_TypeCheck(list, OperationListType))
            return wrong("the first argument must be lists of operations");
        s->lists[i] = &((OperationList *)list)->list;
        s->constants[i] = data_of(((OperationList *)list)->constants[0]);
    }
    if (!taken(args[1], NPY_DOUBLE, 1, &x->b) || !taken(args[2], NPY_DOUBLE, 1, &x->scale) ||
        !taken(args[3], NPY_DOUBLE, 1, &x->t))
        return 0;
    s->b = data_of(x->b), s->scale = data_of(x->scale);
    s->n_b = PyArray_SIZE(x->b), s->rows = shape[1], s->n = shape[2];
    s->m = PyArray_SIZE(x->scale) - s->n;
    npy_intp n = s->n, m = s->m, plain = 1 + 2 * n + s->n_b, size = n + m;
    int good = m >= 0 && shape[0] == 2 && (s->rows == 1 || s->rows == 1 + s->n_b);
    for (int i = 0; good && i < 3; i++) {
        const operation_list *of = s->lists[values[i]], *by = s->lists[changes[i]];
        npy_intp more = 2 * n + s->n_b + (i == 0 ? size : 0);
        good = of->n_inputs == plain && by->n_inputs == plain + more &&
               of->n_outputs == (i == 0 ? n * size + size : m) &&
               by->n_outputs == (i == 0 ? size : m);
    }
    if (!good)
        return wrong("lists, design, scale and states do not fit together");
    npy_intp room = index_1_room(s) + size;
    x->memory = PyMem_Malloc((size_t)room * sizeof(double) + (size_t)(size + 1) * sizeof(int));
    if (!x->memory)
        return PyErr_NoMemory(), 0;
    s->x = x->memory, s->K = s->x + size, s->numbers = s->K + size * (size + 1 + 2 * LIST_LANES);
    s->exchanged = (int *)((double *)x->memory + room);
    return 1;
}

/* Calls one of the two functions of states: rows or, in place, projected. */
static PyObject *of_states(PyObject *const *args, int projected)
{
    Index1 x = {.memory = NULL};
    PyArrayObject *states = NULL, *out = NULL;
    int trouble = SOLVED;
    if (taken(args[4], NPY_DOUBLE, 4, &states) &&
        index_1_taken(&x, args, PyArray_DIMS(states) + PyArray_NDIM(states) - 3) &&
        (PyArray_NDIM(states) == 4 || wrong("states must have four axes")) &&
        (PyArray_SIZE(x.t) == PyArray_DIM(states, 0) || wrong("each state must have a time"))) {
        const index_1 *s = &x.system;
        npy_intp shape[] = {s->rows, s->n + s->m}, count = 2 * s->rows * s->n;
        const double *t = data_of(x.t);
        out = projected ? (PyArrayObject *)PyArray_NewCopy(states, NPY_CORDER)
                        : zeros_like(states, 3, 2, shape, NPY_DOUBLE);
        for (npy_intp k = 0; out && !trouble && k < PyArray_DIM(states, 0); k++) {
            double *to = (double *)PyArray_DATA(out);
            trouble = projected ? index_1_projected(s, t[k], to + k * count)
                                : index_1_rows(s, t[k], (const double *)data_of(states) + k * count,
                                               to + k * shape[0] * shape[1]);
        }
    }
    index_1_dropped(&x);
    Py_XDECREF(states);
    if (trouble) {
        Py_XDECREF(out);
        return PyLong_FromLong(trouble);
    }
    return (PyObject *)out;
}

/* index_1_rows(lists, b, scale, t, states) */
static PyObject *py_index_1_rows(PyObject *const *args)
{
    return of_states(args, 0);
}

/* index_1_projected(lists, b, scale, t, states) */
static PyObject *py_index_1_projected(PyObject *const *args)
{
    return of_states(args, 1);
}

/* An array of doubles in one piece that may be written to, of a shape. */
static double *written_to(PyObject *object, int axes, const npy_intp *shape)
{
    PyArrayObject *x = (PyArrayObject *)object;
    if (!PyArray_Check(object) || PyArray_TYPE(x) != NPY_DOUBLE || !PyArray_ISCARRAY(x) ||
        PyArray_NDIM(x) != axes || !ends_with(x, axes, shape)) {
        wrong("an array to write to has another shape or type, or is not in one piece");
        return NULL;
    }
    return PyArray_DATA(x);
}

/* index_1_stages(lists, b, scale, times, factors, rows, states, out, first, last) */
static PyObject *py_index_1_stages(PyObject *const *args)
{
    Index1 x = {.memory = NULL};
    PyArrayObject *factors = NULL;
    PyObject *result = NULL;
    npy_intp first, last;
    PyArrayObject *model = (PyArrayObject *)args[6];
    if (!PyArray_Check(args[6]) || PyArray_NDIM(model) != 4)
        return wrong("states must be an array of four axes"), NULL;
    npy_intp stages = PyArray_DIM(model, 0), width = stages + 2;
    if (taken(args[4], NPY_DOUBLE, 3, &factors) &&
        index_1_taken(&x, args, PyArray_DIMS(model) + 1) &&
        taken_number(args[9], stages, &last) && taken_number(args[8], last, &first)) {
        const index_1 *s = &x.system;
        npy_intp n = s->n, of_factors[] = {stages, 2, width}, of_rows[] = {width, s->rows * n};
        npy_intp of_out[] = {stages, s->rows, n + s->m};
        double *rows = written_to(args[5], 2, of_rows);
        double *states = rows ? written_to(args[6], 4, PyArray_DIMS(model)) : NULL;
        double *out = states ? written_to(args[7], 3, of_out) : NULL;
        if (out && ((ends_with(factors, 3, of_factors) && PyArray_SIZE(x.t) >= last) ||
                    wrong("factors or times do not fit")))
            result = PyLong_FromLong(index_1_stages(s, first, last, width, data_of(x.t),
                                                    data_of(factors), rows, states, out));
    }
    index_1_dropped(&x);
    Py_XDECREF(factors);
    return result;
}
