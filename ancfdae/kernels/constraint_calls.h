/* What Python calls of constraints: a plan, made once, and functions of it. */

enum { PLAN_INDICES = 13, PLAN_NUMBERS = 3 };

/* Indices and numbers in the order of `ConstraintTable` and `constraint_numbers`; the numbers are
 * real, or nullptr, and complex. `arguments` are those that it was made of. */
struct ConstraintPlan {
    PyObject_HEAD PyObject *arguments;
    PyArrayObject *indices[PLAN_INDICES], *real[PLAN_NUMBERS], *complex_[PLAN_NUMBERS];
    ConstraintTable plan;
    ConstraintNumbers<double> in_real;
    ConstraintNumbers<Complex> in_complex;
    int type;
};

void plan_dropped(ConstraintPlan *self)
{
    Py_XDECREF(self->arguments);
    for (int i = 0; i < PLAN_INDICES; i++)
        Py_XDECREF(self->indices[i]);
    for (int i = 0; i < PLAN_NUMBERS; i++) {
        Py_XDECREF(self->real[i]);
        Py_XDECREF(self->complex_[i]);
    }
    PyTypeObject *type = Py_TYPE((PyObject *)self);
    PyObject_Free(self);
    Py_DECREF(type);
}

int ascending(const int32_t *at, Size count, Size stride, Size end)
{
    int good = count > 0 && at[0] == 0 && at[(count - 1) * stride] == end;
    for (Size i = 1; good && i < count; i++)
        good = at[i * stride] >= at[(i - 1) * stride];
    return good;
}

/* Whether `count` entries of L stand in the rows of a vector at component `at`. */
Size entries_of(const ConstraintTable *p, int32_t at, int components)
{
    return p->first[at + components] - p->first[at];
}

/* Whether everything of one joint lies within it, and there are as many places as are taken. */
int joint_fits(const ConstraintTable *p, const int32_t *joint)
{
    const int32_t *next = joint + JOINT_ITEMS;
    Size begin = joint[VECTOR] * p->d, end = next[VECTOR] * p->d, linear = 0, products = 0;
    int good = 1;
    for (int32_t e = joint[LINEAR]; good && e < next[LINEAR]; e++) {
        good = p->linear_at[e] >= begin && p->linear_at[e] < end;
        linear += good ? entries_of(p, p->linear_at[e], 1) : 0;
    }
    for (int32_t e = joint[PRODUCT]; good && e < next[PRODUCT]; e++) {
        good =
            p->i[e] >= begin && p->i[e] <= end - p->d && p->j[e] >= begin && p->j[e] <= end - p->d;
        products += good ? entries_of(p, p->i[e], p->d) + entries_of(p, p->j[e], p->d) : 0;
    }
    for (int32_t e = joint[MOVING]; good && e < next[MOVING]; e++)
        good = p->moving_part[e] >= joint[PART] && p->moving_part[e] < next[PART];
    return good && linear == next[PLACE_LINEAR] - joint[PLACE_LINEAR] &&
           products == next[PLACE_PRODUCT] - joint[PLACE_PRODUCT];
}

int plan_fits(ConstraintPlan *self)
{
    ConstraintTable *p = &self->plan;
    PyArrayObject *const *x = self->indices;
    Size n_U = PyArray_SIZE(x[1]) - 1, curved = 0;
    const Size ends[JOINT_ITEMS] = {p->d ? n_U / p->d : 0,
                                    p->n_a,
                                    p->n_s,
                                    p->n_lam,
                                    p->n_parts,
                                    p->n_moving,
                                    PyArray_SIZE(x[8]),
                                    PyArray_SIZE(x[9])};
    int good = p->d > 0 && n_U >= 0 && n_U % p->d == 0 && p->n_parts > 0 && p->n_joints >= 0 &&
               PyArray_SIZE(x[0]) == (p->n_joints + 1) * JOINT_ITEMS &&
               p->n_l == PyArray_SIZE(x[2]);
    for (int i = 0; good && i < JOINT_ITEMS; i++)
        good = i == PART ? p->joints[PART] == 1 &&
                               p->joints[p->n_joints * JOINT_ITEMS + PART] == p->n_parts
                         : ascending(p->joints + i, p->n_joints + 1, JOINT_ITEMS, ends[i]);
    for (Size k = 0; good && k < p->n_joints; k++)
        good = p->joints[(k + 1) * JOINT_ITEMS + PART] >= p->joints[k * JOINT_ITEMS + PART];
    good = good && ascending(p->first, n_U + 1, 1, p->n_l) && within_32(x[2], 0, p->n_q - 1) &&
           PyArray_SIZE(x[4]) == p->n_a && PyArray_SIZE(x[6]) == p->n_s &&
           PyArray_SIZE(x[7]) == p->n_s && within_32(x[3], 0, p->n_lam - 1) &&
           within_32(x[5], 0, p->n_lam - 1) && within_32(x[8], 0, p->n_values - 1) &&
           within_32(x[9], 0, p->n_values - 1);
    for (Size k = 0; good && k < p->n_joints; k++) {
        const int32_t *joint = p->joints + k * JOINT_ITEMS;
        Size size = (joint[JOINT_ITEMS + VECTOR] - joint[VECTOR]) * p->d;
        p->most = size > p->most ? size : p->most;
        good = joint_fits(p, joint);
    }
    for (Size e = 0; good && e < p->n_s; e++)
        for (int axis = 0; axis < p->d; axis++)
            curved += 2 * entries_of(p, p->i[e] + axis, 1) * entries_of(p, p->j[e] + axis, 1);
    return (good && curved == PyArray_SIZE(x[10]) && within_32(x[10], 0, p->n_curved - 1)) ||
           wrong("these are not the indices of constraints");
}

/* Take the arrays of a plan; numbers as complex ones too, which states may be. */
int plan_taken(ConstraintPlan *self, PyObject *indices, PyObject *numbers)
{
    ConstraintTable *p = &self->plan;
    const int32_t **to[] = {&p->joints,       &p->first,         &p->columns, &p->linear_row,
                            &p->linear_at,    &p->row,           &p->i,       &p->j,
                            &p->place_linear, &p->place_product, &p->curved,  &p->moving_at,
                            &p->moving_part};
    for (int i = 0; i < PLAN_INDICES; i++) {
        if (!taken(PyTuple_GetItem(indices, i), NPY_INT32, 1, &self->indices[i]))
            return 0;
        *to[i] = data_of(self->indices[i]);
    }
    self->type = NPY_DOUBLE;
    for (int i = 0; i < PLAN_NUMBERS; i++)
        if (is_complex(PyTuple_GetItem(numbers, i)))
            self->type = NPY_CDOUBLE;
    for (int i = 0; i < PLAN_NUMBERS; i++) {
        PyObject *x = PyTuple_GetItem(numbers, i);
        if (!taken(x, NPY_CDOUBLE, 1, &self->complex_[i]) ||
            (self->type == NPY_DOUBLE && !taken(x, NPY_DOUBLE, 1, &self->real[i])))
            return 0;
    }
    self->in_real = (ConstraintNumbers<double>){data_of(self->real[0]), data_of(self->real[1]),
                                                data_of(self->real[2])};
    self->in_complex = (ConstraintNumbers<Complex>){
        data_of(self->complex_[0]), data_of(self->complex_[1]), data_of(self->complex_[2])};
    return 1;
}

int plan_filled(ConstraintPlan *self, PyObject *arguments)
{
    PyObject *indices, *numbers;
    ConstraintTable *p = &self->plan;
    Py_ssize_t n_values, n_curved, n_q;
    if (!PyArg_ParseTuple(arguments, "O!O!innn", &PyTuple_Type, &indices, &PyTuple_Type, &numbers,
                          &p->d, &n_q, &n_values, &n_curved))
        return 0;
    if (PyTuple_Size(indices) != PLAN_INDICES || PyTuple_Size(numbers) != PLAN_NUMBERS)
        return wrong("a plan is made of 13 arrays of indices and 3 of numbers");
    if (!plan_taken(self, indices, numbers))
        return 0;
    Size rows = PyArray_SIZE(self->indices[0]) / JOINT_ITEMS;
    if (rows < 1 || PyArray_SIZE(self->indices[1]) < 1)
        return wrong("these are not the indices of constraints");
    p->n_joints = rows - 1;
    p->n_q = n_q, p->n_values = n_values, p->n_curved = n_curved;
    p->n_lam = p->joints[p->n_joints * JOINT_ITEMS + ROW];
    p->n_parts = p->joints[p->n_joints * JOINT_ITEMS + PART];
    p->n_a = PyArray_SIZE(self->indices[3]), p->n_s = PyArray_SIZE(self->indices[5]);
    p->n_c = p->n_a + p->n_s + p->n_lam;
    p->n_l = PyArray_SIZE(self->complex_[0]), p->n_moving = PyArray_SIZE(self->complex_[2]);
    if (PyArray_SIZE(self->complex_[1]) != p->n_c ||
        PyArray_SIZE(self->indices[12]) != p->n_moving ||
        PyArray_SIZE(self->indices[11]) != p->n_moving ||
        !within_32(self->indices[11], 0, p->n_c - 1))
        return wrong("there must be a number for every entry of constraints");
    return plan_fits(self);
}

PyObject *plan_new(PyTypeObject *type, PyObject *arguments, PyObject *names)
{
    ConstraintPlan *self = (ConstraintPlan *)PyType_GenericAlloc(type, 0);
    if (!self)
        return nullptr;
    self->arguments = Py_NewRef(arguments);
    if ((names && PyDict_Size(names) > 0 && !wrong("a plan takes no names")) ||
        !plan_filled(self, arguments))
        Py_CLEAR(self);
    return (PyObject *)self;
}

PyObject *plan_reduced(PyObject *self, PyObject *none)
{
    (void)none;
    return Py_BuildValue("(OO)", Py_TYPE(self), ((ConstraintPlan *)self)->arguments);
}

static PyMethodDef plan_methods[] = {{"__reduce__", plan_reduced, METH_NOARGS, nullptr},
                                     {nullptr, nullptr, 0, nullptr}};
static PyType_Slot plan_slots[] = {{Py_tp_dealloc, (void *)plan_dropped},
                                   {Py_tp_methods, plan_methods},
                                   {Py_tp_new, (void *)plan_new},
                                   {0, nullptr}};
static PyType_Spec plan_type = {"ancfdae.kernels._kernels.ConstraintPlan", sizeof(ConstraintPlan),
                                0, Py_TPFLAGS_DEFAULT, plan_slots};
static PyTypeObject *ConstraintPlanType; /* Made when the module is imported. */

/* ---- functions of a plan -------------------------------------------------------------------- */

/* Rows of states with the factors of time, all of one type. */
struct ConstraintStates {
    ConstraintPlan *of;
    PyArrayObject *factors, *lam, *X[ORDERS];
    int n, type;
    Size k, instants;
};

void states_dropped(ConstraintStates *x)
{
    Py_XDECREF(x->factors);
    Py_XDECREF(x->lam);
    for (int i = 0; i < ORDERS; i++)
        Py_XDECREF(x->X[i]);
}

/* Take factors, lam or None, and the motion, from one to four arrays. */
int states_taken(ConstraintStates *x, PyObject *plan, PyObject *factors, PyObject *lam,
                 PyObject *const *motion, Py_ssize_t count)
{
    memset(x, 0, sizeof *x);
    if (!PyObject_TypeCheck(plan, ConstraintPlanType))
        return wrong("the first argument must be a plan");
    if (count < 1 || count > ORDERS)
        return wrong("there must be coordinates and up to three time derivatives");
    x->of = (ConstraintPlan *)plan;
    x->n = (int)count - 1;
    x->type = x->of->type == NPY_CDOUBLE || is_complex(factors) || is_complex(lam) ? NPY_CDOUBLE
                                                                                   : NPY_DOUBLE;
    for (Py_ssize_t i = 0; i < count; i++)
        if (is_complex(motion[i]))
            x->type = NPY_CDOUBLE;
    if (!taken(factors, x->type, 3, &x->factors) || !taken_or_none(lam, x->type, 1, &x->lam))
        return 0;
    const ConstraintTable *p = &x->of->plan;
    for (Py_ssize_t i = 0; i < count; i++)
        if (!taken(motion[i], x->type, 1, &x->X[i]))
            return 0;
        else if (!ends_with(x->X[i], 1, &p->n_q) || !PyArray_SAMESHAPE(x->X[i], x->X[0]))
            return wrong("states must have n_q numbers, and one shape");
    x->k = leading_size(x->X[0], 1);
    x->instants = PyArray_DIM(x->factors, 1);
    if (PyArray_NDIM(x->factors) != 3 || PyArray_DIM(x->factors, 0) <= x->n ||
        (x->instants != 1 && x->instants != x->k) || PyArray_DIM(x->factors, 2) != p->n_parts)
        return wrong("factors must be (orders, instants, n_parts)");
    if (x->lam && (!ends_with(x->lam, 1, &p->n_lam) || leading_size(x->lam, 1) != x->k))
        return wrong("there must be n_lam multipliers for each state");
    return 1;
}

/* Numbers of work for coefficients, and for vectors. */
void *states_work(const ConstraintStates *x)
{
    const ConstraintTable *p = &x->of->plan;
    Size size = (x->n + 1) * (p->n_c + p->most) * (x->type == NPY_DOUBLE ? 8 : 16);
    Memory work = new_room((size_t)size + 1);
    if (!work)
        PyErr_NoMemory();
    return work;
}

/* Coefficients and states of instant k, for one type. */
#define AT_INSTANT(type_, T_)                                                                      \
    const T_ *c[ORDERS], *X[ORDERS], *factors = data_of(x.factors), *lam = data_of(x.lam);         \
    T_ *U = (T_ *)work + (x.n + 1) * p->n_c;                                                       \
    coefficients<T_>(p, &x.of->in_##type_, x.n, x.instants > 1 ? k : 0, x.instants, factors,       \
                     (T_ *)work, c);                                                               \
    for (int order = 0; order <= x.n; order++)                                                     \
        X[order] = (const T_ *)data_of(x.X[order]) + k * p->n_q;                                   \
    lam = lam ? lam + k * p->n_lam : nullptr;

/* constraints(plan, what, factors, lam, *motion) */
PyObject *py_constraints(PyObject *const *args, Py_ssize_t count)
{
    ConstraintStates x;
    Size what;
    PyArrayObject *out = nullptr;
    if (count < 5)
        return wrong("constraints takes 5 to 8 arguments"), nullptr;
    int good = taken_number(args[1], FORCE, &what);
    if (!good)
        return nullptr;
    if (states_taken(&x, args[0], args[2], args[3], args + 4, count - 4)) {
        const ConstraintTable *p = &x.of->plan;
        Size sizes[] = {p->n_lam, p->n_values, p->n_q}, size = sizes[what];
        void *work = states_work(&x);
        if (work && (what == FORCE) != (x.lam != nullptr))
            wrong("multipliers belong to forces");
        else if (work)
            out = zeros_like(x.X[0], 1, 1, &size, x.type);
        for (Size k = 0; out && k < x.k; k++)
            if (x.type == NPY_DOUBLE) {
                AT_INSTANT(real, double)
                constraints<double>(p, x.of->in_real.l, (int)what, x.n, c, X, lam, U,
                                    (double *)data_of(out) + k * size);
            } else {
                AT_INSTANT(complex, Complex)
                constraints<Complex>(p, x.of->in_complex.l, (int)what, x.n, c, X, lam, U,
                                     (Complex *)data_of(out) + k * size);
            }
        PyMem_Free(work);
    }
    states_dropped(&x);
    return (PyObject *)out;
}

/* constraint_curvature(plan, factors, lam); the factors are of one order. */
PyObject *py_constraint_curvature(PyObject *const *args)
{
    if (!PyObject_TypeCheck(args[0], ConstraintPlanType))
        return wrong("the first argument must be a plan"), nullptr;
    ConstraintPlan *of = (ConstraintPlan *)args[0];
    const ConstraintTable *p = &of->plan;
    PyArrayObject *factors = nullptr, *lam = nullptr, *out = nullptr;
    int type = of->type == NPY_CDOUBLE || is_complex(args[1]) || is_complex(args[2]) ? NPY_CDOUBLE
                                                                                     : NPY_DOUBLE;
    Memory work = new_room((size_t)p->n_c * 16 + 1);
    if (work && taken(args[1], type, 2, &factors) && taken(args[2], type, 1, &lam)) {
        Size k = leading_size(lam, 1), instants = PyArray_DIM(factors, 0);
        if (!ends_with(lam, 1, &p->n_lam) || PyArray_NDIM(factors) != 2 ||
            PyArray_DIM(factors, 1) != p->n_parts || (instants != 1 && instants != k))
            wrong("there must be n_parts factors and n_lam multipliers for each instant");
        else
            out = zeros_like(lam, 1, 1, &p->n_curved, type);
        for (Size i = 0; out && i < k; i++)
            if (type == NPY_DOUBLE) {
                const double *c;
                coefficients<double>(p, &of->in_real, 0, instants > 1 ? i : 0, instants,
                                     data_of(factors), work, &c);
                constraint_curvature<double>(p, of->in_real.l, c,
                                             (const double *)data_of(lam) + i * p->n_lam,
                                             (double *)data_of(out) + i * p->n_curved);
            } else {
                const Complex *c;
                coefficients<Complex>(p, &of->in_complex, 0, instants > 1 ? i : 0, instants,
                                      data_of(factors), work, &c);
                constraint_curvature<Complex>(p, of->in_complex.l, c,
                                              (const Complex *)data_of(lam) + i * p->n_lam,
                                              (Complex *)data_of(out) + i * p->n_curved);
            }
    }
    PyMem_Free(work);
    Py_XDECREF(factors);
    Py_XDECREF(lam);
    return (PyObject *)out;
}

/* constraint_gradient(plan, factors, w, *motion) */
PyObject *py_constraint_gradient(PyObject *const *args, Py_ssize_t count)
{
    ConstraintStates x;
    PyArrayObject *on_l = nullptr, *on_c = nullptr;
    if (count < 4)
        return wrong("constraint_gradient takes 4 to 7 arguments"), nullptr;
    if (states_taken(&x, args[0], args[1], args[2], args + 3, count - 3)) {
        const ConstraintTable *p = &x.of->plan;
        Size orders[] = {x.n + 1, p->n_c}, rows = (x.n + 1) * p->n_c;
        void *work = states_work(&x);
        if (work && !x.lam)
            wrong("an array is missing");
        else if (work) {
            on_l = zeros_like(x.X[0], 1, 1, &p->n_l, x.type);
            on_c = zeros_like(x.X[0], 1, 2, orders, x.type);
        }
        for (Size k = 0; on_l && on_c && k < x.k; k++)
            if (x.type == NPY_DOUBLE) {
                AT_INSTANT(real, double)
                constraint_gradient<double>(p, x.of->in_real.l, x.n, c, X, lam, U,
                                            (double *)data_of(on_l) + k * p->n_l,
                                            (double *)data_of(on_c) + k * rows);
            } else {
                AT_INSTANT(complex, Complex)
                constraint_gradient<Complex>(p, x.of->in_complex.l, x.n, c, X, lam, U,
                                             (Complex *)data_of(on_l) + k * p->n_l,
                                             (Complex *)data_of(on_c) + k * rows);
            }
        PyMem_Free(work);
    }
    states_dropped(&x);
    if (!on_l || !on_c) {
        Py_XDECREF(on_l);
        Py_XDECREF(on_c);
        return nullptr;
    }
    return Py_BuildValue("(NN)", on_l, on_c);
}

/* ---- totals --------------------------------------------------------------------------------- */

enum { PARTIAL_INDICES = 5 };

/* Arrays of partials (variable, number, first, part, entry, value), of factors, of their partials
 * or nullptr, and of lam and the motion with their derivatives. */
struct TotalArguments {
    PyArrayObject *indices[PARTIAL_INDICES], *value, *factors_b, *lam_b, *X_b[ORDERS];
    ConstraintPartials partials;
};

void totals_dropped(TotalArguments *a)
{
    for (int i = 0; i < PARTIAL_INDICES; i++)
        Py_XDECREF(a->indices[i]);
    Py_XDECREF(a->value);
    Py_XDECREF(a->factors_b);
    Py_XDECREF(a->lam_b);
    for (int i = 0; i < ORDERS; i++)
        Py_XDECREF(a->X_b[i]);
}

int partials_taken(TotalArguments *a, const ConstraintTable *p, PyObject *partials)
{
    ConstraintPartials *of = &a->partials;
    const int32_t **to[] = {&of->variable, &of->number, &of->first, &of->part, &of->entry};
    if (!PyTuple_Check(partials) || PyTuple_Size(partials) != PARTIAL_INDICES + 1)
        return wrong("partials are (variable, number, first, part, entry, value)");
    for (int i = 0; i < PARTIAL_INDICES; i++) {
        if (!taken(PyTuple_GetItem(partials, i), NPY_INT32, 1, &a->indices[i]))
            return 0;
        *to[i] = data_of(a->indices[i]);
    }
    if (!taken(PyTuple_GetItem(partials, PARTIAL_INDICES), NPY_DOUBLE, 1, &a->value))
        return 0;
    of->value = data_of(a->value);
    of->n_b = PyArray_SIZE(a->indices[0]) - 1;
    Size reached = PyArray_SIZE(a->indices[1]), size = PyArray_SIZE(a->value);
    return (ascending(of->variable, of->n_b + 1, 1, reached) &&
            PyArray_SIZE(a->indices[2]) == reached + 1 &&
            ascending(of->first, reached + 1, 1, size) &&
            within_32(a->indices[1], 0, p->n_joints - 1) && PyArray_SIZE(a->indices[3]) == size &&
            within_32(a->indices[3], 0, p->n_parts - 1) && PyArray_SIZE(a->indices[4]) == size &&
            within_32(a->indices[4], 0, p->n_l + p->n_c - 1)) ||
           wrong("these are not the partials of constraints");
}

/* Derivatives as rows, (instants, n_b, size), or nullptr for None. */
int rows_taken(PyObject *object, Size k, Size n_b, Size size, PyArrayObject **x)
{
    const Size shape[] = {n_b, size};
    return taken_or_none(object, NPY_DOUBLE, 2, x) &&
           (!*x || (ends_with(*x, 2, shape) && leading_size(*x, 2) == k) ||
            wrong("there must be a row of derivatives for each instant and variable"));
}

int totals_taken(TotalArguments *a, const ConstraintStates *x, PyObject *factors_b, PyObject *lam_b,
                 PyObject *motion_b)
{
    const ConstraintTable *p = &x->of->plan;
    Size n_b = a->partials.n_b;
    Size shape[] = {n_b, x->n + 1, x->instants, p->n_parts};
    if (x->type != NPY_DOUBLE)
        return wrong("totals are those of real numbers");
    if (x->instants != x->k)
        return wrong("there must be factors for each state");
    if (!taken_or_none(factors_b, NPY_DOUBLE, 4, &a->factors_b) ||
        (a->factors_b && !ends_with(a->factors_b, 4, shape) &&
         !wrong("factors_b must be (n_b, ...)")))
        return 0;
    a->partials.factors_b = data_of(a->factors_b);
    if (!rows_taken(lam_b, x->k, n_b, p->n_lam, &a->lam_b))
        return 0;
    if (motion_b == Py_None)
        return !a->lam_b || wrong("with lam_b there must be derivatives of the motion");
    if (!PyTuple_Check(motion_b) || PyTuple_Size(motion_b) != x->n + 1)
        return wrong("there must be derivatives of all of the motion, or of none");
    for (int i = 0; i <= x->n; i++)
        if (!rows_taken(PyTuple_GetItem(motion_b, i), x->k, n_b, p->n_q, &a->X_b[i]) ||
            (!a->X_b[i] && !wrong("an array is missing")))
            return 0;
    return 1;
}

/* constraint_totals(plan, partials, factors, factors_b, lam, lam_b, motion, motion_b) */
PyObject *py_constraint_totals(PyObject *const *args)
{
    TotalArguments a;
    ConstraintStates x;
    PyArrayObject *out = nullptr;
    memset(&a, 0, sizeof a);
    if (!PyTuple_Check(args[6]) || PyTuple_Size(args[6]) > ORDERS)
        return wrong("the motion must be a tuple of up to four arrays"), nullptr;
    PyObject *motion[ORDERS];
    Py_ssize_t count = PyTuple_Size(args[6]);
    for (Py_ssize_t i = 0; i < count; i++)
        motion[i] = PyTuple_GetItem(args[6], i);
    if (states_taken(&x, args[0], args[2], args[4], motion, count) &&
        partials_taken(&a, &x.of->plan, args[1]) &&
        totals_taken(&a, &x, args[3], args[5], args[7])) {
        const ConstraintTable *p = &x.of->plan;
        Size size = x.lam ? p->n_q : p->n_lam, shape[] = {x.k, a.partials.n_b, size};
        TotalStates states = {x.lam ? FORCE : RATE,
                              x.n,
                              x.k,
                              data_of(x.factors),
                              {nullptr},
                              {nullptr},
                              data_of(x.lam),
                              data_of(a.lam_b)};
        for (int i = 0; i <= x.n; i++) {
            states.X[i] = data_of(x.X[i]);
            states.X_b[i] = data_of(a.X_b[i]);
        }
        Memory work = new_room((size_t)totals_work(p, x.n) * 16 + 1);
        if (!work)
            PyErr_NoMemory();
        else
            out = (PyArrayObject *)PyArray_ZEROS(3, shape, NPY_DOUBLE, 0);
        if (out)
            constraint_totals(p, &x.of->in_real, &a.partials, &states, work, data_of(out));
        PyMem_Free(work);
    }
    totals_dropped(&a);
    states_dropped(&x);
    return (PyObject *)out;
}
