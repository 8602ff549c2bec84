/* Plans of marches (march.h) from the arrays of Python, checked once for all steps.
 *
 * `__init__.py` says what a plan, a layout of the matrix and the rules hold.
 */

enum { MOST_KEPT = 64 };

/* A plan with the arrays that it points to and its room. */
typedef struct {
    PyObject *kept[MOST_KEPT];
    int n_kept;
    plan_real plan;
    fronts fronts;
    room_real room;
    constraint_plan none; /* of lists: sizes only */
    listed_real listed;
    void *memory;
    moving_load_real *moving;
} Prepared;

static const char *const prepared_name = "ancfdae.march";

static void prepared_dropped(Prepared *x)
{
    for (int i = 0; i < x->n_kept; i++)
        Py_DECREF(x->kept[i]);
    free(x->memory);
    PyMem_Free(x->moving);
    PyMem_Free(x);
}

static void capsule_dropped(PyObject *capsule)
{
    prepared_dropped(PyCapsule_GetPointer(capsule, prepared_name));
}

/* An array that is kept; with this size unless it is negative. */
static PyArrayObject *kept(Prepared *x, PyObject *object, int type, int axes, npy_intp size)
{
    PyArrayObject *array = NULL;
    if (!object || x->n_kept == MOST_KEPT)
        return NULL;
    if (!taken(object, type, axes, &array)) {
        Py_XDECREF(array);
        return NULL;
    }
    x->kept[x->n_kept++] = (PyObject *)array;
    if (size >= 0 && PyArray_SIZE(array) != size)
        return wrong("an array of a plan has another size"), NULL;
    return array;
}

static const double *kept_numbers(Prepared *x, PyObject *object, npy_intp size)
{
    return data_of(kept(x, object, NPY_DOUBLE, 0, size));
}

/* Indices from 0 to `most`. */
static const npy_int64 *kept_indices(Prepared *x, PyObject *object, npy_intp size, npy_intp most)
{
    PyArrayObject *array = kept(x, object, NPY_INT64, 1, size);
    return array && (within_64(array, most) || wrong("an index of a plan is too large"))
               ? data_of(array)
               : NULL;
}

static const npy_int32 *kept_short_indices(Prepared *x, PyObject *object, npy_intp size,
                                           npy_intp most)
{
    PyArrayObject *array = kept(x, object, NPY_INT32, 1, size);
    return array && (within_32(array, 0, most) || wrong("an index of a plan is too large"))
               ? data_of(array)
               : NULL;
}

/* A matrix (first, columns, values) of n rows; n is taken from it where it is negative. */
static int kept_csr(Prepared *x, PyObject *tuple, npy_intp n, npy_intp n_columns, csr_real *m)
{
    PyArrayObject *first = kept(x, item(tuple, 3, 0), NPY_INT32, 1, n < 0 ? -1 : n + 1);
    PyArrayObject *columns = kept(x, item(tuple, 3, 1), NPY_INT32, 1, -1);
    PyArrayObject *values = kept(x, item(tuple, 3, 2), NPY_DOUBLE, 1, -1);
    if (!first || !columns || !values || !is_csr(first, columns, values, n_columns))
        return 0;
    csr_real made = {PyArray_SIZE(first) - 1, data_of(first), data_of(columns), data_of(values)};
    *m = made;
    return 1;
}

static int kept_block(Prepared *x, PyObject *object, PyObject *index)
{
    Arguments a;
    plan_real *p = &x->plan;
    if (x->n_kept + 5 > MOST_KEPT)
        return 0;
    int good = filled(&a, object, NULL, 0) && lawful(&a) &&
               (a.type == NPY_DOUBLE || wrong("a plan is made of real numbers"));
    PyArrayObject *own[] = {a.A, a.g_o, a.bending, a.tau, a.vectors};
    for (int i = 0; i < 5; i++)
        if (own[i])
            x->kept[x->n_kept++] = (PyObject *)own[i];
    if (!good)
        return 0;
    npy_intp k = 1, size = (npy_intp)(a.n_y + 1) * a.d;
    BLOCK_OF_TYPE(real)
    p->block = b;
    p->n_y = a.n_y, p->d = a.d, p->n_q = a.n_q, p->damped = a.tau != NULL;
    p->index = kept_short_indices(x, index, a.n * size * size, p->nnz - 1);
    return p->index != NULL;
}

enum { PLAN_ITEMS = 14, LAYOUT_ITEMS = 5 };

/* A plan of constraints, and (first, columns, values) of Phi_q. */
static int kept_constraints(Prepared *x, PyObject *object, PyObject *B)
{
    plan_real *p = &x->plan;
    if (!PyObject_TypeCheck(object, ConstraintPlanType) || x->n_kept == MOST_KEPT)
        return wrong("constraints must be a plan of theirs");
    x->kept[x->n_kept++] = Py_NewRef(object);
    const ConstraintPlan *own = (ConstraintPlan *)object;
    p->constraints = &own->plan, p->numbers = own->in_real;
    p->n_lam = own->plan.n_lam, p->still = own->plan.n_parts == 1;
    if (own->type != NPY_DOUBLE || own->plan.n_q != p->n_q || own->plan.n_curved != p->nnz)
        return wrong("constraints must be real, and those of the coordinates");
    return kept_csr(x, B, p->n_lam, p->n_q, &p->B) &&
           (p->B.first[p->n_lam] == own->plan.n_values ||
            wrong("there must be a value for each entry of the constraint Jacobian"));
}

/* Pairs of a plan of a load that moves, and whether it uses velocities. */
static int kept_loads(Prepared *x, PyObject *pairs)
{
    plan_real *p = &x->plan;
    if (!pairs || !PyTuple_Check(pairs) || x->n_kept == MOST_KEPT)
        return wrong("a plan is made of named tuples");
    x->kept[x->n_kept++] = Py_NewRef(pairs);
    p->n_moving = PyTuple_Size(pairs), p->n_factors = p->n_loads + p->n_moving;
    p->velocity = p->damped;
    p->moving = x->moving = PyMem_Calloc((size_t)p->n_moving + 1, sizeof *x->moving);
    if (!x->moving)
        return PyErr_NoMemory(), 0;
    for (npy_intp k = 0; k < p->n_moving; k++) {
        PyObject *pair = PyTuple_GetItem(pairs, k), *object = item(pair, 2, 0);
        const LoadPlan *own = (const LoadPlan *)object;
        if (!object)
            return 0;
        if (!PyObject_TypeCheck(object, LoadPlanType) || own->type != NPY_DOUBLE ||
            own->plan.n_q != p->n_q || own->plan.n_values != p->nnz)
            return wrong("loads must be real, and those of the coordinates");
        int velocity = PyObject_IsTrue(item(pair, 2, 1));
        x->moving[k] = (moving_load_real){&own->plan, own->in_real, velocity};
        p->velocity |= velocity;
    }
    return 1;
}

/* Places of the lower triangle in an envelope or in fronts, of `size` numbers. */
static int kept_lower(Prepared *x, PyObject *chosen, PyObject *places, npy_intp size)
{
    plan_real *p = &x->plan;
    PyArrayObject *own = kept(x, chosen, NPY_INT32, 1, -1);
    if (!own || !within_32(own, 0, p->nnz - 1))
        return PyErr_Occurred() ? 0 : wrong("an index of a plan is too large");
    p->chosen = data_of(own), p->n_chosen = PyArray_SIZE(own);
    p->places = kept_short_indices(x, places, p->n_chosen + p->constraints->n_values, size - 1);
    return p->places != NULL;
}

/* (chosen, places, fronts). */
static int kept_fronts(Prepared *x, PyObject *t)
{
    plan_real *p = &x->plan;
    PyArrayObject *own[FRONT_ARRAYS] = {NULL};
    npy_intp n = p->n_q + p->n_lam;
    npy_int32 *marks = PyMem_Malloc((2 * (size_t)n + 1) * sizeof *marks);
    int good = marks && x->n_kept + FRONT_ARRAYS <= MOST_KEPT && item(t, 3, 2) &&
               fronts_taken(item(t, 3, 2), own, &x->fronts);
    for (int i = 0; i < FRONT_ARRAYS; i++)
        if (own[i])
            x->kept[x->n_kept++] = (PyObject *)own[i];
    good = good && (x->fronts.n == n || wrong("the fronts are not those of the matrix")) &&
           (fronts_closed(&x->fronts, marks, marks + n) || wrong("a front lacks rows"));
    PyMem_Free(marks);
    p->fronts = &x->fronts;
    return good && kept_lower(x, item(t, 3, 0), item(t, 3, 1), x->fronts.column_at[n]);
}

/* (order, scale, envelope, band, fronts); an envelope is (first, chosen, places, signs), a band
 * (half, flat, factors) and fronts (chosen, places, arrays), or None. */
static int kept_layout(Prepared *x, PyObject *t)
{
    plan_real *p = &x->plan;
    npy_intp n = p->n_q + p->n_lam, n_B = p->constraints->n_values;
    PyObject *own = item(t, LAYOUT_ITEMS, 2), *band = item(t, LAYOUT_ITEMS, 3);
    PyObject *in_fronts = item(t, LAYOUT_ITEMS, 4);
    p->order = kept_indices(x, item(t, LAYOUT_ITEMS, 0), n, n - 1);
    p->scale = kept_numbers(x, item(t, LAYOUT_ITEMS, 1), n);
    if (!p->order || !p->scale || (own == Py_None && band == Py_None && in_fronts == Py_None))
        return PyErr_Occurred() ? 0 : wrong("a layout must have an envelope, a band or fronts");
    if (in_fronts != Py_None && !kept_fronts(x, in_fronts))
        return 0;
    if (own != Py_None) {
        Envelope e = {NULL, 0, 0};
        int good = item(own, 4, 0) && envelope_taken(item(own, 4, 0), &e);
        if (e.first && x->n_kept < MOST_KEPT)
            x->kept[x->n_kept++] = (PyObject *)e.first;
        if (!good || e.n != n)
            return PyErr_Occurred() ? 0 : wrong("the envelope is not that of the matrix");
        p->first = data_of(e.first);
        p->signs = kept_numbers(x, item(own, 4, 3), n);
        if (!p->signs || !kept_lower(x, item(own, 4, 1), item(own, 4, 2), e.size))
            return 0;
    }
    if (band != Py_None) {
        if (!item(band, 3, 0) || !taken_number(item(band, 3, 0), (INT_MAX - 1) / 3, &p->half))
            return 0;
        npy_intp size = p->nnz + 2 * n_B;
        p->flat = kept_indices(x, item(band, 3, 1), size, n * (3 * p->half + 1) - 1);
        p->factors = kept_numbers(x, item(band, 3, 2), size);
        if (!p->flat || !p->factors || n > INT_MAX)
            return PyErr_Occurred() ? 0 : wrong("the band is too large");
    }
    return 1;
}

/* Give room to pointers, one behind the other; counts are numbers of doubles. */
static int given_room(Prepared *x)
{
    const plan_real *p = &x->plan;
    const constraint_plan *c = p->constraints;
    room_real *r = &x->room;
    size_t n_q = (size_t)p->n_q, n_lam = (size_t)p->n_lam, n = n_q + n_lam;
    size_t nnz = (size_t)p->nnz, total = 0;
    size_t envelope = p->first ? (size_t)p->first[n] : 0;
    size_t band = p->flat ? n * (3 * (size_t)p->half + 1) : 0;
    const fronts *f = p->fronts;
    size_t lower = f ? (size_t)f->column_at[n] : 0, most = f ? (size_t)f->most : 0;
    size_t factors = f ? (size_t)f->factor_at[f->count] : 0, of_fronts = f ? n : 0;
    size_t matrix = envelope > band ? envelope : band;
    struct {
        double **to;
        size_t size;
    } rooms[] = {{&r->q_p, n_q}, {&r->dq_p, n_q}, {&r->v_p, n_q}, {&r->q, n_q}, {&r->v, n_q},
                 {&r->A, n_q}, {&r->a, n_q}, {&r->lam, n_lam}, {&r->U, 2 * (size_t)c->most},
                 {&r->B, (size_t)c->n_values},
                 {&r->Q, n_q}, {&r->inner, n_q}, {&r->reaction, n_q}, {&r->ahead, n_q},
                 {&r->start, n_q}, {&r->Phi, n_lam}, {&r->rate, n_lam}, {&r->defect, n_lam},
                 {&r->R, n}, {&r->x, n}, {&r->force, n_q}, {&r->f_q, nnz},
                 {&r->f_v, p->velocity ? nnz : 0}, {&r->sum, p->flat ? nnz : 0},
                 {&r->matrix, matrix > factors ? matrix : factors}, {&r->work, 12 * n + 4 * most},
                 {&r->in_fronts.a, lower}, {&r->in_fronts.perturbed, lower},
                 {&r->in_fronts.scale, of_fronts}, {&r->in_fronts.room, 5 * most},
                 {&r->in_fronts.stack, f ? (size_t)f->stack : 0},
                 {&r->at_end, (size_t)c->n_c}, {&r->within, 2 * (size_t)c->n_c}, {&r->least, n},
                 {&r->mass, p->listed ? nnz : 0}, {&r->numbers, 0}, {&r->of_load, 0}};
    int count = (int)(sizeof rooms / sizeof rooms[0]);
    for (npy_intp k = 0; k < p->n_moving; k++) {
        size_t size = (size_t)load_work_real(p->moving[k].plan, p->moving[k].plan->n_U);
        rooms[count - 1].size = size > rooms[count - 1].size ? size : rooms[count - 1].size;
    }
    for (int i = 0; p->listed && i < MARCH_LISTS; i++)
        if ((size_t)p->listed->of[i]->n_numbers > rooms[count - 2].size)
            rooms[count - 2].size = (size_t)p->listed->of[i]->n_numbers;
    for (int i = 0; i < count; i++)
        total += rooms[i].size;
    x->memory = calloc(total + n + of_fronts + 1, sizeof(double));
    if (!x->memory)
        return PyErr_NoMemory(), 0;
    double *at = x->memory;
    for (int i = 0; i < count; i++) {
        *rooms[i].to = at;
        at += rooms[i].size;
    }
    r->pivots = (int *)at;
    r->in_fronts.at = (npy_int32 *)(at + n);
    return 1;
}

/* Whether factors in a band can be made, or need not. */
static int with_lapack(plan_real *p)
{
    static void *gbtrf, *gbtrs;
    if (!p->flat)
        return 1;
    p->gbtrf = (gbtrf_t_real)lapack(&gbtrf, "dgbtrf", "void (int *, int *, int *, int *, ");
    p->gbtrs = (gbtrs_t_real)lapack(&gbtrs, "dgbtrs", "void (char *, int *, int *, int *, int *, ");
    return p->gbtrf && p->gbtrs;
}

/* Lists and b; all take t, q, v, A, lam and b. */
static int kept_lists(Prepared *x, PyObject *lists, PyObject *b)
{
    plan_real *p = &x->plan;
    listed_real *s = &x->listed;
    npy_intp n = p->n_q, m = p->n_lam, outputs[] = {x->none.n_values, m, m, n, p->nnz, p->nnz};
    PyArrayObject *own = kept(x, b, NPY_DOUBLE, 1, -1);
    if (!own || !item(lists, MARCH_LISTS, 0))
        return 0;
    x->kept[x->n_kept++] = Py_NewRef(lists);
    s->b = data_of(own), s->n_b = PyArray_SIZE(own);
    outputs[OF_TANGENTS] *= p->velocity ? 2 : 1;
    for (int i = 0; i < MARCH_LISTS; i++) {
        PyObject *list = PyTuple_GetItem(lists, i);
        if (!PyObject_TypeCheck(list, OperationListType))
            return wrong("a plan must have lists of operations");
        s->of[i] = &((OperationList *)list)->list;
        s->constants[i] = data_of(((OperationList *)list)->constants[0]);
        if (s->of[i]->n_inputs != 1 + 3 * n + m + s->n_b || s->of[i]->n_outputs != outputs[i])
            return wrong("lists must be those of the coordinates");
    }
    p->listed = s;
    return 1;
}

enum { LIST_PLAN_ITEMS = 7 };

/* What `march` takes of (lists, b, weights, inverse, B, K, velocity); M has the pattern of K. */
static PyObject *prepared_lists(PyObject *const *args)
{
    enum { LISTS, DESIGN, WEIGHTS, INVERSE, OF_B, OF_K, VELOCITY };
    PyObject *t = args[0];
    Prepared *x = PyMem_Calloc(1, sizeof *x);
    if (!x)
        return PyErr_NoMemory();
    plan_real *p = &x->plan;
    PyArrayObject *weights = kept(x, PyTuple_GetItem(t, WEIGHTS), NPY_DOUBLE, 1, -1);
    const double *rules = kept_numbers(x, args[2], sizeof(march_rules) / sizeof(double));
    int velocity = PyObject_IsTrue(PyTuple_GetItem(t, VELOCITY));
    p->velocity = velocity, p->constraints = &x->none, p->n_factors = x->none.n_parts = 1;
    if (!weights || !rules || velocity < 0 || (p->n_q = PyArray_SIZE(weights), 0) ||
        !(p->inverse = kept_numbers(x, PyTuple_GetItem(t, INVERSE), p->n_q)) ||
        !kept_csr(x, PyTuple_GetItem(t, OF_B), -1, p->n_q, &p->B) ||
        !kept_csr(x, PyTuple_GetItem(t, OF_K), p->n_q, p->n_q, &p->K))
        return prepared_dropped(x), NULL;
    p->weights = data_of(weights), p->n_lam = p->B.n, p->nnz = p->K.first[p->n_q];
    x->none.n_q = p->n_q, x->none.n_lam = p->n_lam, x->none.n_values = p->B.first[p->n_lam];
    memcpy(&p->rules, rules, sizeof p->rules);
    if (!kept_lists(x, PyTuple_GetItem(t, LISTS), PyTuple_GetItem(t, DESIGN)) ||
        !kept_layout(x, args[1]) || !given_room(x) ||
        !with_lapack(p))
        return prepared_dropped(x), NULL;
    p->K.values = x->room.mass, p->M = p->K;
    PyObject *capsule = PyCapsule_New(x, prepared_name, capsule_dropped);
    return capsule ? capsule : (prepared_dropped(x), NULL);
}

/* prepare(plan, layout, rules): what `march` takes. */
static PyObject *py_prepare(PyObject *const *args)
{
    if (PyTuple_Check(args[0]) && PyTuple_Size(args[0]) == LIST_PLAN_ITEMS)
        return prepared_lists(args);
    Prepared *x = PyMem_Calloc(1, sizeof *x);
    if (!x)
        return PyErr_NoMemory();
    plan_real *p = &x->plan;
    PyObject *t = args[0];
    PyObject *pattern = item(t, PLAN_ITEMS, 3);
    PyArrayObject *mass = kept(x, item(pattern, 3, 2), NPY_DOUBLE, 1, -1);
    const double *rules = kept_numbers(x, args[2], sizeof(march_rules) / sizeof(double));
    if (!mass || !rules || (p->nnz = PyArray_SIZE(mass), 0) ||
        !kept_block(x, item(t, PLAN_ITEMS, 0), item(t, PLAN_ITEMS, 1)) ||
        !kept_csr(x, item(t, PLAN_ITEMS, 2), p->n_q, p->n_q, &p->M) ||
        !kept_csr(x, pattern, p->n_q, p->n_q, &p->K))
        return prepared_dropped(x), NULL;
    memcpy(&p->rules, rules, sizeof p->rules);
    PyArrayObject *loads = kept(x, item(t, PLAN_ITEMS, 5), NPY_DOUBLE, 2, -1);
    p->gravity = kept_numbers(x, item(t, PLAN_ITEMS, 4), p->n_q);
    p->weights = kept_numbers(x, item(t, PLAN_ITEMS, 6), p->n_q);
    p->inverse = kept_numbers(x, item(t, PLAN_ITEMS, 7), p->n_q);
    if (!loads || !p->gravity || !p->weights || !p->inverse ||
        (PyArray_DIM(loads, 1) != p->n_q && !wrong("a load must have a number for each coordinate")) ||
        (p->loads = data_of(loads), p->n_loads = PyArray_DIM(loads, 0),
         !kept_loads(x, item(t, PLAN_ITEMS, 12))) ||
        !kept_constraints(x, item(t, PLAN_ITEMS, 8), item(t, PLAN_ITEMS, 9)) || !kept_layout(x, args[1]) || !given_room(x) || !with_lapack(p))
        return prepared_dropped(x), NULL;
    PyObject *capsule = PyCapsule_New(x, prepared_name, capsule_dropped);
    return capsule ? capsule : (prepared_dropped(x), NULL);
}

/* Whether an array has a shape; negative numbers are any. */
static int shaped(PyArrayObject *x, int axes, const npy_intp *shape)
{
    int good = PyArray_NDIM(x) == axes;
    for (int i = 0; good && i < axes; i++)
        good = shape[i] < 0 || PyArray_DIM(x, i) == shape[i];
    return good || wrong("states, tables and rows must have the shapes of a plan");
}

/* Arguments of a march: sizes of steps, the state, tables of factors, and rows to write. */
typedef struct {
    PyArrayObject *h, *state[5], *of_joints, *of_loads, *a;
    double *rows[4];
    npy_intp k, instants;
} Marching;

static void marching_dropped(Marching *m)
{
    Py_XDECREF(m->h);
    for (int i = 0; i < 5; i++)
        Py_XDECREF(m->state[i]);
    Py_XDECREF(m->of_joints);
    Py_XDECREF(m->of_loads);
    Py_XDECREF(m->a);
}

static int marching_taken(const plan_real *p, PyObject *const *args, Marching *m)
{
    npy_intp sizes[] = {p->n_q, p->n_q, p->n_q, p->n_lam, p->n_q}, any = -1;
    npy_intp out_sizes[] = {p->n_q, p->n_q, p->n_q, p->n_lam};
    memset(m, 0, sizeof *m);
    if (!taken(args[3], NPY_DOUBLE, 1, &m->h) || !shaped(m->h, 1, &any) ||
        !taken(args[4], NPY_DOUBLE, 3, &m->of_joints) ||
        !taken(args[5], NPY_DOUBLE, 3, &m->of_loads))
        return 0;
    m->k = PyArray_SIZE(m->h);
    for (int i = 0; i < 5; i++)
        if (!item(args[1], 5, i) || !taken(item(args[1], 5, i), NPY_DOUBLE, 1, &m->state[i]) ||
            !shaped(m->state[i], 1, sizes + i))
            return 0;
    for (int i = 0; i < 4; i++) {
        PyArrayObject *row = (PyArrayObject *)item(args[7], 4, i);
        npy_intp shape[] = {m->k, out_sizes[i]};
        if (!row)
            return 0;
        if (!PyArray_Check((PyObject *)row) || PyArray_TYPE(row) != NPY_DOUBLE ||
            !PyArray_ISCARRAY(row))
            return wrong("rows must be arrays of real numbers in one piece");
        if (!shaped(row, 2, shape))
            return 0;
        m->rows[i] = PyArray_DATA(row);
    }
    npy_intp of_joints[] = {p->still ? -1 : m->k, -1, p->constraints->n_parts};
    npy_intp of_loads[] = {m->k, 2, p->n_factors};
    m->instants = p->still ? ALL_INSTANTS : PyArray_DIM(m->of_joints, 1);
    m->a = (PyArrayObject *)PyArray_SimpleNew(1, sizes, NPY_DOUBLE);
    return m->a && shaped(m->of_joints, 3, of_joints) && shaped(m->of_loads, 3, of_loads) &&
           (m->instants >= 2 || wrong("a table must tell the factors at both ends of a step"));
}

/* march(prepared, state, motion, h, of_joints, of_loads, seconds, rows): as many steps as can be
 * taken; returns their number, why it ends, the size of the motion, a, and counts. */
static PyObject *py_march(PyObject *const *args)
{
    Prepared *x = PyCapsule_GetPointer(args[0], prepared_name);
    double motion = PyFloat_AsDouble(args[2]), seconds = PyFloat_AsDouble(args[6]);
    if (!x || PyErr_Occurred())
        return NULL;
    Marching m;
    PyObject *result = NULL;
    room_real *r = &x->room;
    if (marching_taken(&x->plan, args, &m)) {
        before_real b = {data_of(m.state[0]), data_of(m.state[1]), data_of(m.state[2]),
                         data_of(m.state[3]), data_of(m.state[4]), motion};
        const double *of_joints = data_of(m.of_joints), *of_loads = data_of(m.of_loads);
        double *a = PyArray_DATA(m.a);
        int ends = ALL_TAKEN;
        npy_intp steps;
        memset(r->counts, 0, sizeof r->counts);
        Py_BEGIN_ALLOW_THREADS
        steps = marched_real(&x->plan, r, &b, m.k, data_of(m.h), m.instants, of_joints, of_loads,
                             seconds_now() + seconds, m.rows, a, &ends);
        Py_END_ALLOW_THREADS
        result = Py_BuildValue("nidO(nnn)", steps, ends, b.motion, m.a, r->counts[0], r->counts[1],
                               r->counts[2]);
    }
    marching_dropped(&m);
    return result;
}

/* ---- passes -------------------------------------------------------------------------------- */

/* An array of real numbers of this shape, in place; NULL where it is None and may be. */
static int in_place(PyObject *object, int optional, int axes, const npy_intp *shape, double **data)
{
    PyArrayObject *x = (PyArrayObject *)object;
    *data = NULL;
    if (optional && object == Py_None)
        return 1;
    if (!PyArray_Check(object) || PyArray_TYPE(x) != NPY_DOUBLE || !PyArray_ISCARRAY(x))
        return wrong("arrays of a pass must be real numbers in one piece");
    *data = PyArray_DATA(x);
    return shaped(x, axes, shape);
}

static int of_a_scene(const Prepared *x)
{
    return !x->plan.listed || wrong("lists of operations only march");
}

enum { STEPS_ITEMS = 7 };

/* (h, q, v, lam, of_joints, of_loads, matrices) of k steps. */
static int steps_taken(PyObject *t, const plan_real *p, computed_steps *s)
{
    npy_intp any = -1;
    double *x[STEPS_ITEMS];
    if (!item(t, STEPS_ITEMS, 0) || !in_place(item(t, STEPS_ITEMS, 0), 0, 1, &any, &x[0]))
        return 0;
    npy_intp k = PyArray_DIM((PyArrayObject *)item(t, STEPS_ITEMS, 0), 0);
    npy_intp shapes[][3] = {{k, p->n_q}, {k, p->n_q}, {k, p->n_lam},
                            {p->still ? -1 : k, p->constraints->n_parts}, {k, p->n_factors}, {k, 6, 4}};
    for (int i = 1; i < STEPS_ITEMS; i++)
        if (!in_place(item(t, STEPS_ITEMS, i), 0, i < STEPS_ITEMS - 1 ? 2 : 3, shapes[i - 1], &x[i]))
            return 0;
    computed_steps made = {k, x[0], x[1], x[2], x[3], x[4], x[5], x[6]};
    *s = made;
    return 1;
}

/* differentiate_steps(prepared, steps, right, z, states, lam_b): how many, and why it ends. */
static PyObject *py_differentiate_steps(PyObject *const *args)
{
    Prepared *x = PyCapsule_GetPointer(args[0], prepared_name);
    computed_steps s;
    double *right, *z, *states, *lam_b;
    if (!x || !of_a_scene(x) || !steps_taken(args[1], &x->plan, &s))
        return NULL;
    const plan_real *p = &x->plan;
    npy_intp n = p->n_q + p->n_lam, any[] = {4, -1, p->n_q};
    if (!in_place(args[3], 0, 3, any, &z))
        return NULL;
    npy_intp n_b = PyArray_DIM((PyArrayObject *)args[3], 1), taken_steps;
    npy_intp of_right[] = {s.k, n_b, n}, of_states[] = {s.k, 3, n_b, p->n_q};
    npy_intp of_lam[] = {s.k, n_b, p->n_lam};
    if (!in_place(args[2], 0, 3, of_right, &right) || !in_place(args[4], 0, 4, of_states, &states) ||
        !in_place(args[5], 0, 3, of_lam, &lam_b))
        return NULL;
    double *room = malloc((size_t)(n_b * n) * sizeof(double) + 1);
    int ends = ALL_TAKEN;
    if (!room)
        return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS
    taken_steps = differentiated(p, &x->room, &s, n_b, right, z, states, lam_b, room, &ends);
    Py_END_ALLOW_THREADS
    free(room);
    return Py_BuildValue("ni", taken_steps, ends);
}

/* pull_back_steps(prepared, steps, seeds, on, mu, zeta): how many, and why it ends. */
static PyObject *py_pull_back_steps(PyObject *const *args)
{
    Prepared *x = PyCapsule_GetPointer(args[0], prepared_name);
    computed_steps s;
    double *seeds[3], *on, *mu, *zeta;
    if (!x || !of_a_scene(x) || !steps_taken(args[1], &x->plan, &s))
        return NULL;
    const plan_real *p = &x->plan;
    npy_intp of_q[] = {s.k, p->n_q}, of_lam[] = {s.k, p->n_lam}, of_on[] = {6, p->n_q}, steps;
    for (int i = 0; i < 3; i++)
        if (!item(args[2], 3, i) ||
            !in_place(item(args[2], 3, i), 1, 2, i < 2 ? of_q : of_lam, &seeds[i]))
            return NULL;
    if (!in_place(args[3], 0, 2, of_on, &on) || !in_place(args[4], 0, 2, of_q, &mu) ||
        !in_place(args[5], 0, 2, of_lam, &zeta))
        return NULL;
    int ends = ALL_TAKEN;
    const double *const given[] = {seeds[0], seeds[1], seeds[2]};
    Py_BEGIN_ALLOW_THREADS
    steps = pulled_back(p, &x->room, &s, given, on, mu, zeta, &ends);
    Py_END_ALLOW_THREADS
    return Py_BuildValue("ni", steps, ends);
}

/* ---- equilibria ------------------------------------------------------------------------------ */

/* rest(prepared, state, known, factors, rules): Newton's method from a state (q, lam, q_s, lam_s),
 * written in place, with (q_0, anchor or None, r_0, Phi_0); why it ends, iterations, the size of the
 * last correction, and whether K is known to be positive definite there. */
static PyObject *py_rest(PyObject *const *args)
{
    enum { STATE, KNOWN = 4, FACTORS = 8, ALL = 11 };
    Prepared *x = PyCapsule_GetPointer(args[0], prepared_name);
    if (!x || !of_a_scene(x))
        return NULL;
    const plan_real *p = &x->plan;
    npy_intp of_q = p->n_q, of_lam = p->n_lam, of_rules = sizeof(rest_rules) / sizeof(double);
    npy_intp of_joints = p->constraints->n_parts, of_loads = p->n_factors;
    npy_intp sizes[ALL] = {of_q, of_lam, of_q, of_lam, of_q, of_q, of_q, of_lam, of_joints,
                           of_loads, of_loads};
    double *data[ALL], *rules;
    for (int i = 0; i < ALL; i++) {
        int group = i < KNOWN ? STATE : i < FACTORS ? KNOWN : FACTORS;
        PyObject *own = item(args[1 + group / 4], group == FACTORS ? 3 : 4, i - group);
        if (!own || !in_place(own, i == KNOWN + 1, 1, sizes + i, data + i))
            return NULL;
    }
    if (!in_place(args[4], 0, 1, &of_rules, &rules))
        return NULL;
    rest_problem own = {.q_0 = data[4], .anchor = data[5], .r_0 = data[6], .Phi_0 = data[7],
                        .of_joints = data[8], .of_loads = data[9], .of_turning = data[10]};
    rest_state to = {data[0], data[1], data[2], data[3], INFINITY, 0, 0};
    memcpy(&own.rules, rules, sizeof own.rules);
    int why;
    Py_BEGIN_ALLOW_THREADS
    why = rested(p, &x->room, &own, &to);
    Py_END_ALLOW_THREADS
    return Py_BuildValue("iidi", why, to.iterations, to.size, to.definite);
}
