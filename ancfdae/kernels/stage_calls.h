/* Stages of a step (stages.h) as Python calls them. */

/* Room for a step, one pointer behind the other. */
void *stage_room(StageStep *s)
{
    const Plan<double> *p = s->plan;
    size_t n = STAGES * (size_t)(p->n_q + p->n_lam);
    size_t band = n * (3 * (size_t)s->half + 1), n_B = STAGES * (size_t)p->constraints->n_values;
    double *at = (double *)malloc((4 * n + n_B + (size_t)s->size_K + band + 1) * sizeof(double));
    if (!at)
        return PyErr_NoMemory();
    s->R = at, s->change = s->R + n, s->work = s->change + n, s->B = s->work + n;
    s->K = s->B + n_B, s->band = s->K + s->size_K, s->pivots = (int *)(s->band + band);
    return at;
}

/* Indices from 0 to `most`, as they stand; any number of them where `size` is negative. */
const int64_t *indices_in_place(PyObject *object, Size size, Size most)
{
    PyArrayObject *x = (PyArrayObject *)object;
    if (!object || !PyArray_Check(object) || PyArray_TYPE(x) != NPY_INT64 ||
        !PyArray_ISCARRAY_RO(x) || PyArray_SIZE(x) != size || !within_64(x, most))
        return PyErr_Occurred() ? nullptr
                                : (wrong("indices of stages do not fit together"), nullptr);
    return data_of(x);
}

/* (order, scale, half, flat, factors, places) of the coupled matrix; sets `size_K`. */
int coupled_taken(PyObject *t, StageStep *s)
{
    const Plan<double> *p = s->plan;
    Size n = STAGES * (p->n_q + p->n_lam), n_B = STAGES * p->constraints->n_values;
    double *scale, *factors;
    if (!item(t, COUPLED_ITEMS, 0) || !taken_number(item(t, COUPLED_ITEMS, 2), MOST_HALF, &s->half))
        return 0;
    Size any = -1;
    if (!in_place(item(t, COUPLED_ITEMS, 1), 0, 1, &n, &scale) ||
        !in_place(item(t, COUPLED_ITEMS, 4), 0, 1, &any, &factors))
        return 0;
    Size values = PyArray_SIZE((PyArrayObject *)item(t, COUPLED_ITEMS, 4));
    s->size_K = values - 2 * n_B, s->scale = scale, s->factors = factors;
    if (s->size_K != STAGES * STAGES * p->nnz || n > INT_MAX)
        return wrong("the matrix of stages is not that of the plan");
    s->order = indices_in_place(item(t, COUPLED_ITEMS, 0), n, n - 1);
    s->flat = indices_in_place(item(t, COUPLED_ITEMS, 3), values, n * (3 * s->half + 1) - 1);
    s->places = indices_in_place(item(t, COUPLED_ITEMS, 5), s->size_K, s->size_K - 1);
    return s->order && s->flat && s->places;
}

/* (q, v, a, lam) before, x and lam to be overwritten, factors of joints and of loads. */
int stages_taken(PyObject *const *args, StageStep *s)
{
    const Plan<double> *p = s->plan;
    Size of_x[] = {STAGES, p->n_q}, of_lam[] = {STAGES, p->n_lam}, any[] = {-1, -1};
    double *x[BEGIN_ITEMS], *tables[2];
    for (int i = 0; i < BEGIN_ITEMS; i++)
        if (!item(args[2], BEGIN_ITEMS, i) ||
            !in_place(item(args[2], BEGIN_ITEMS, i), 0, 1, i < 3 ? of_x + 1 : of_lam + 1, &x[i]))
            return 0;
    Size of_joints[] = {STAGES + 1, p->constraints->n_parts};
    Size of_loads[] = {STAGES + 1, p->n_factors};
    s->q = x[0], s->v = x[1], s->a = x[2], s->lam_before = x[3];
    int good = in_place(args[3], 0, 2, of_x, &s->x) && in_place(args[4], 0, 2, of_lam, &s->lam) &&
               in_place(args[5], 0, 2, p->still ? any : of_joints, &tables[0]) &&
               in_place(args[6], 0, 2, of_loads, &tables[1]);
    s->of_joints = tables[0], s->of_loads = tables[1];
    return good;
}

/* solve_stages(prepared, coupled, state, x, lam, of_joints, of_loads, tableau, rules): how it ends,
 * size of the last correction, and counts. */
PyObject *py_solve_stages(PyObject *const *args)
{
    static void *gbtrf, *gbtrs;
    Prepared *prepared = prepared_of(args[0]);
    Size of_tableau = sizeof(StageTableau) / sizeof(double);
    Size of_rules = sizeof(StageRules) / sizeof(double);
    double *tableau, *rules;
    if (!prepared)
        return nullptr;
    StageStep s = {};
    s.plan = &prepared->plan, s.room = &prepared->room;
    if (!coupled_taken(args[1], &s) || !stages_taken(args, &s) ||
        !in_place(args[7], 0, 1, &of_tableau, &tableau) ||
        !in_place(args[8], 0, 1, &of_rules, &rules))
        return nullptr;
    s.tableau = (const StageTableau *)tableau, s.rules = (const StageRules *)rules;
    s.gbtrf = (Gbtrf<double>)lapack(&gbtrf, "dgbtrf", "void (int *, int *, int *, int *, ");
    s.gbtrs = (Gbtrs<double>)lapack(&gbtrs, "dgbtrs", "void (char *, int *, int *, int *, int *, ");
    void *memory = s.gbtrf && s.gbtrs ? stage_room(&s) : nullptr;
    if (!memory)
        return nullptr;
    int ends;
    Py_BEGIN_ALLOW_THREADS ends = stages_iterated(&s);
    Py_END_ALLOW_THREADS free(memory);
    return Py_BuildValue("id(nnn)", ends, s.size, s.iterations, s.factorisations, s.stuck);
}
