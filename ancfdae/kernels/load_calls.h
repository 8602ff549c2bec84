/* What Python calls of loads: a plan, made once, and functions of it. */

enum { LOAD_INDICES = 7 };

/* Indices in the order of `LoadTable`, and numbers (l, constants), real ones or nullptr, and complex. */
struct LoadPlan {
    PyObject_HEAD PyObject *arguments;
    PyArrayObject *indices[LOAD_INDICES], *real[2], *complex_[2];
    LoadTable plan;
    LoadNumbers<double> in_real;
    LoadNumbers<Complex> in_complex;
    int type;
};

void load_dropped(LoadPlan *self)
{
    Py_XDECREF(self->arguments);
    for (int i = 0; i < LOAD_INDICES; i++)
        Py_XDECREF(self->indices[i]);
    for (int i = 0; i < 2; i++) {
        Py_XDECREF(self->real[i]);
        Py_XDECREF(self->complex_[i]);
    }
    PyTypeObject *type = Py_TYPE((PyObject *)self);
    PyObject_Free(self);
    Py_DECREF(type);
}

int load_fits(const LoadPlan *self)
{
    const LoadTable *p = &self->plan;
    PyArrayObject *const *x = self->indices;
    Size ahead = 2 * p->n_U + p->n_constants, n_l = PyArray_SIZE(self->complex_[0]);
    int good = ascending(p->first, p->n_U + 1, 1, n_l) && PyArray_SIZE(x[1]) == n_l &&
               within_32(x[1], 0, p->n_q - 1) && within_32(x[2], 0, OPERATIONS - 1) &&
               PyArray_SIZE(x[3]) == p->n_operations && PyArray_SIZE(x[4]) == p->n_operations &&
               PyArray_SIZE(x[5]) == p->n_U && within_32(x[5], 0, p->n_numbers - 1) &&
               PyArray_SIZE(x[6]) == n_l * n_l && within_32(x[6], 0, p->n_values - 1);
    for (Size k = 0; good && k < p->n_operations; k++)
        good = p->a[k] >= 0 && p->a[k] < ahead + k && p->b[k] >= 0 && p->b[k] < ahead + k;
    return good || wrong("these are not the indices of a load");
}

/* LoadPlan(indices, numbers, n_q, n_values) */
int load_filled(LoadPlan *self, PyObject *arguments)
{
    PyObject *indices, *numbers;
    Py_ssize_t n_q, n_values;
    LoadTable *p = &self->plan;
    const int32_t **to[] = {&p->first, &p->columns, &p->op, &p->a, &p->b, &p->output, &p->places};
    if (!PyArg_ParseTuple(arguments, "O!O!nn", &PyTuple_Type, &indices, &PyTuple_Type, &numbers,
                          &n_q, &n_values))
        return 0;
    if (PyTuple_Size(indices) != LOAD_INDICES || PyTuple_Size(numbers) != 2)
        return wrong("a load is made of 7 arrays of indices and 2 of numbers");
    for (int i = 0; i < LOAD_INDICES; i++) {
        if (!taken(PyTuple_GetItem(indices, i), NPY_INT32, 1, &self->indices[i]))
            return 0;
        *to[i] = data_of(self->indices[i]);
    }
    PyObject *x[] = {PyTuple_GetItem(numbers, 0), PyTuple_GetItem(numbers, 1)};
    self->type = is_complex(x[0]) || is_complex(x[1]) ? NPY_CDOUBLE : NPY_DOUBLE;
    for (int i = 0; i < 2; i++)
        if (!taken(x[i], NPY_CDOUBLE, 1, &self->complex_[i]) ||
            (self->type == NPY_DOUBLE && !taken(x[i], NPY_DOUBLE, 1, &self->real[i])))
            return 0;
    self->in_real = (LoadNumbers<double>){data_of(self->real[0]), data_of(self->real[1])};
    self->in_complex =
        (LoadNumbers<Complex>){data_of(self->complex_[0]), data_of(self->complex_[1])};
    p->n_q = n_q, p->n_values = n_values;
    p->n_U = PyArray_SIZE(self->indices[0]) - 1, p->n_constants = PyArray_SIZE(self->complex_[1]);
    p->n_operations = PyArray_SIZE(self->indices[2]);
    p->n_numbers = 2 * p->n_U + p->n_constants + p->n_operations;
    return load_fits(self);
}

PyObject *load_new(PyTypeObject *type, PyObject *arguments, PyObject *names)
{
    LoadPlan *self = (LoadPlan *)PyType_GenericAlloc(type, 0);
    if (!self)
        return nullptr;
    self->arguments = Py_NewRef(arguments);
    if ((names && PyDict_Size(names) > 0 && !wrong("a plan takes no names")) ||
        !load_filled(self, arguments))
        Py_CLEAR(self);
    return (PyObject *)self;
}

PyObject *load_reduced(PyObject *self, PyObject *none)
{
    (void)none;
    return Py_BuildValue("(OO)", Py_TYPE(self), ((LoadPlan *)self)->arguments);
}

static PyMethodDef load_methods[] = {{"__reduce__", load_reduced, METH_NOARGS, nullptr},
                                     {nullptr, nullptr, 0, nullptr}};
static PyType_Slot load_slots[] = {{Py_tp_dealloc, (void *)load_dropped},
                                   {Py_tp_methods, load_methods},
                                   {Py_tp_new, (void *)load_new},
                                   {0, nullptr}};
static PyType_Spec load_type = {"ancfdae.kernels._kernels.LoadPlan", sizeof(LoadPlan), 0,
                                Py_TPFLAGS_DEFAULT, load_slots};
static PyTypeObject *LoadPlanType; /* Made when the module is imported. */

/* ---- functions of a plan -------------------------------------------------------------------- */

/* Factors, and rows of q, v, and dq and dv or nullptr, all of one type. */
struct LoadStates {
    LoadPlan *of;
    PyArrayObject *factors, *x[4];
    int type;
    Size k;
};

void load_states_dropped(LoadStates *x)
{
    Py_XDECREF(x->factors);
    for (int i = 0; i < 4; i++)
        Py_XDECREF(x->x[i]);
}

int load_states_taken(LoadStates *x, PyObject *const *args, int count)
{
    memset(x, 0, sizeof *x);
    if (!PyObject_TypeCheck(args[0], LoadPlanType))
        return wrong("the first argument must be the plan of a load");
    x->of = (LoadPlan *)args[0];
    x->type = x->of->type;
    for (int i = 1; i < count + 2; i++)
        if (is_complex(args[i]))
            x->type = NPY_CDOUBLE;
    if (!taken(args[1], x->type, 1, &x->factors))
        return 0;
    for (int i = 0; i < count; i++)
        if (!taken(args[2 + i], x->type, 2, &x->x[i]))
            return 0;
        else if (!ends_with(x->x[i], 1, &x->of->plan.n_q) || !PyArray_SAMESHAPE(x->x[i], x->x[0]))
            return wrong("states must have n_q numbers, and one shape");
    x->k = leading_size(x->x[0], 1);
    return PyArray_SIZE(x->factors) == x->k || wrong("there must be a factor for each instant");
}

#define LOAD_AT_INSTANT(T_)                                                                        \
    const T_ *q = (const T_ *)data_of(x.x[0]) + k * p->n_q;                                        \
    const T_ *v = (const T_ *)data_of(x.x[1]) + k * p->n_q;                                        \
    T_ s = ((const T_ *)data_of(x.factors))[k], *to = (T_ *)data_of(out) + k * size;

/* load_forces(plan, factors, q, v) */
PyObject *py_load_forces(PyObject *const *args)
{
    LoadStates x;
    PyArrayObject *out = nullptr;
    if (load_states_taken(&x, args, 2)) {
        const LoadTable *p = &x.of->plan;
        Size size = p->n_q;
        Memory work = new_room((size_t)load_work<Complex>(p, 0) * 16 + 1);
        out = work ? zeros_like(x.x[0], 1, 1, &size, x.type) : (PyErr_NoMemory(), nullptr);
        for (Size k = 0; out && k < x.k; k++)
            if (x.type == NPY_DOUBLE) {
                LOAD_AT_INSTANT(double)
                load_force<double>(p, &x.of->in_real, s, q, v, work, to);
            } else {
                LOAD_AT_INSTANT(Complex)
                load_force<Complex>(p, &x.of->in_complex, s, q, v, work, to);
            }
        PyMem_Free(work);
    }
    load_states_dropped(&x);
    return (PyObject *)out;
}

/* load_forces_along(plan, factors, q, v, dq, dv) */
PyObject *py_load_forces_along(PyObject *const *args)
{
    LoadStates x;
    PyArrayObject *out = nullptr;
    if (load_states_taken(&x, args, 4)) {
        const LoadTable *p = &x.of->plan;
        Size size = p->n_q;
        Memory work = new_room((size_t)load_work<Complex>(p, 1) * 16 + 1);
        out = work ? zeros_like(x.x[0], 1, 1, &size, x.type) : (PyErr_NoMemory(), nullptr);
        for (Size k = 0; out && k < x.k; k++)
            if (x.type == NPY_DOUBLE) {
                LOAD_AT_INSTANT(double)
                load_force_along<double>(p, &x.of->in_real, s, q, v,
                                         (const double *)data_of(x.x[2]) + k * size,
                                         (const double *)data_of(x.x[3]) + k * size, work, to);
            } else {
                LOAD_AT_INSTANT(Complex)
                load_force_along<Complex>(p, &x.of->in_complex, s, q, v,
                                          (const Complex *)data_of(x.x[2]) + k * size,
                                          (const Complex *)data_of(x.x[3]) + k * size, work, to);
            }
        PyMem_Free(work);
    }
    load_states_dropped(&x);
    return (PyObject *)out;
}

/* load_tangents(plan, factors, q, v, velocity) */
PyObject *py_load_tangents(PyObject *const *args)
{
    LoadStates x;
    PyArrayObject *out = nullptr;
    int velocity = PyObject_IsTrue(args[4]);
    if (velocity < 0)
        return nullptr;
    if (load_states_taken(&x, args, 2)) {
        const LoadTable *p = &x.of->plan;
        Size size = p->n_values;
        Memory work = new_room((size_t)load_work<Complex>(p, p->n_U) * 16 + 1);
        out = work ? zeros_like(x.x[0], 1, 1, &size, x.type) : (PyErr_NoMemory(), nullptr);
        for (Size k = 0; out && k < x.k; k++)
            if (x.type == NPY_DOUBLE) {
                LOAD_AT_INSTANT(double)
                load_tangent<double>(p, &x.of->in_real, s, q, v, velocity, work, to);
            } else {
                LOAD_AT_INSTANT(Complex)
                load_tangent<Complex>(p, &x.of->in_complex, s, q, v, velocity, work, to);
            }
        PyMem_Free(work);
    }
    load_states_dropped(&x);
    return (PyObject *)out;
}
