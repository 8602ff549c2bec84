/* What Python calls of formulas: a list of operations, made once, and its values. */

enum { LIST_INDICES = 4 };

/* Indices in the order of `operation_list`, and constants, real and complex. */
typedef struct {
    PyObject_HEAD
    PyObject *arguments;
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
    Py_TYPE(self)->tp_free((PyObject *)self);
}

static int list_fits(const OperationList *self)
{
    const operation_list *p = &self->list;
    PyArrayObject *const *x = self->indices;
    npy_intp ahead = p->n_inputs + p->n_constants;
    int good = within_32(x[0], 0, OPERATIONS - 1) && PyArray_SIZE(x[1]) == p->n_operations &&
               PyArray_SIZE(x[2]) == p->n_operations &&
               (p->n_outputs == 0 || (p->n_numbers > 0 && within_32(x[3], 0, p->n_numbers - 1)));
    for (npy_intp k = 0; good && k < p->n_operations; k++)
        good = p->a[k] >= 0 && p->a[k] < ahead + k && p->b[k] >= 0 && p->b[k] < ahead + k;
    return good || wrong("these are not the indices of a list of operations");
}

/* OperationList(n_inputs, constants, op, a, b, outputs) */
static int list_filled(OperationList *self, PyObject *arguments)
{
    PyObject *constants, *indices[LIST_INDICES];
    Py_ssize_t n_inputs;
    operation_list *p = &self->list;
    const npy_int32 **to[] = {&p->op, &p->a, &p->b, &p->outputs};
    if (!PyArg_ParseTuple(arguments, "nOOOOO", &n_inputs, &constants, indices, indices + 1,
                          indices + 2, indices + 3))
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
    OperationList *self = (OperationList *)type->tp_alloc(type, 0);
    if (!self)
        return NULL;
    self->arguments = Py_NewRef(arguments);
    if ((names && PyDict_GET_SIZE(names) > 0 && !wrong("a list takes no names")) ||
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
static PyTypeObject OperationListType = {
    PyVarObject_HEAD_INIT(NULL, 0).tp_name = "ancfdae.kernels._kernels.OperationList",
    .tp_basicsize = sizeof(OperationList),
    .tp_flags = Py_TPFLAGS_DEFAULT,
    .tp_dealloc = (destructor)list_dropped,
    .tp_methods = list_methods,
    .tp_new = list_new,
};

/* list_values(list, inputs) */
static PyObject *py_list_values(PyObject *const *args)
{
    PyArrayObject *x = NULL, *out = NULL;
    int type = is_complex(args[1]) ? NPY_CDOUBLE : NPY_DOUBLE;
    if (!PyObject_TypeCheck(args[0], &OperationListType))
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
