/* Newton's method for the three stages of a step of Radau IIA, in real numbers.
 *
 * The equations, and what stops an iteration, are those of `integrators/radau`: `stages.py` and
 * `newton.py` say what they are. Plans are those of marches (prepared.h).
 */

enum { STAGES = 3, COUPLED_ITEMS = 6, BEGIN_ITEMS = 4, MOST_HALF = 1024 };
/* How it ends. */
enum { STAGES_SOLVED, STAGES_DIVERGED, STAGES_NOT_FINITE, STAGES_SINGULAR };

/* Places c, A^-1 and A^-2. */
typedef struct {
    double c[STAGES], inverse[STAGES][STAGES], squared[STAGES][STAGES];
} stage_tableau;

/* Size of the step and the numbers of `newton.py`. */
typedef struct {
    double h, tolerance, max_iterations, least, more, jump, most, slow, round_off, positions;
} stage_rules;

/* A step: where it begins, what is solved for, and room. R and `change` have the coordinates of all
 * stages, then their multipliers. */
typedef struct {
    const plan_real *plan;
    room_real *room;
    const stage_tableau *tableau;
    const stage_rules *rules;
    const double *q, *v, *a, *lam_before, *of_joints, *of_loads, *scale, *factors;
    const npy_int64 *order, *flat, *places;
    gbtrf_t_real gbtrf;
    gbtrs_t_real gbtrs;
    npy_intp half, size_K, iterations, factorisations, stuck;
    double *x, *lam, *R, *change, *B, *K, *band, *work;
    int *pivots;
    double size, of_B;
} stage_step;

/* Position, velocity and acceleration of stage i, and coefficients of joints, in the room. */
static void stage_state(const stage_step *s, int i)
{
    const plan_real *p = s->plan;
    room_real *r = s->room;
    double h = s->rules->h;
    for (npy_intp e = 0; e < p->n_q; e++) {
        double V = 0, A = 0;
        for (int j = 0; j < STAGES; j++) {
            V += s->tableau->inverse[i][j] * s->x[j * p->n_q + e];
            A += s->tableau->squared[i][j] * s->x[j * p->n_q + e];
        }
        r->q[e] = s->q[e] + h * s->tableau->c[i] * s->v[e] + h * h * s->x[i * p->n_q + e];
        r->v[e] = s->v[e] + h * V;
        r->A[e] = A;
    }
    memcpy(r->lam, s->lam + i * p->n_lam, (size_t)p->n_lam * sizeof(double));
}

/* Coefficients of joints at an instant, of which 3 is the start of the step. */
static void stage_instant(const stage_step *s, int i)
{
    const plan_real *p = s->plan;
    s->room->c[0] = p->listed ? s->of_joints + i : p->numbers.part_0;
    if (!p->still && !p->listed)
        coefficients_real(p->constraints, &p->numbers, 0, 0, 1,
                          s->of_joints + i * p->constraints->n_parts, s->room->at_end, s->room->c);
}

static double squared_size(npy_intp n, const double *x, const double *weights)
{
    double size = size_of_real(n, x, weights);
    return size * size;
}

/* Sizes of accelerations, reactions and forces of all stages together. */
static double motion_of_stages(const stage_step *s, const double sums[3])
{
    return fmax(sqrt(sums[0]) + sqrt(sums[1]) + sqrt(sums[2]), s->rules->least);
}

/* Size of the motion at three stages like the start. */
static double motion_before_stages(const stage_step *s)
{
    const plan_real *p = s->plan;
    room_real *r = s->room;
    stage_instant(s, STAGES);
    jacobian_at_real(p, r, r->c, s->q);
    reaction_of_real(p, r, s->lam_before, r->reaction);
    force_at_real(p, r, s->of_loads + STAGES * p->n_factors, s->q, s->v);
    const double sums[] = {STAGES * squared_size(p->n_q, s->a, p->weights),
                           STAGES * squared_size(p->n_q, r->reaction, p->inverse),
                           STAGES * squared_size(p->n_q, r->Q, p->inverse)};
    return motion_of_stages(s, sums);
}

/* Residuals of all stages and Phi_q there; returns the size of the motion, NaN where one is. */
static double stage_residuals(stage_step *s)
{
    const plan_real *p = s->plan;
    room_real *r = s->room;
    npy_intp n_q = p->n_q, n_lam = p->n_lam, n_B = p->constraints->n_values;
    double sums[3] = {0, 0, 0}, all = 0, h = s->rules->h;
    for (int i = 0; i < STAGES; i++) {
        double *R = s->R + i * n_q, *Phi = s->R + STAGES * n_q + i * n_lam;
        stage_state(s, i);
        stage_instant(s, i);
        constraint_at_real(p, r, r->c, r->q, NULL, Phi);
        jacobian_at_real(p, r, r->c, r->q);
        memcpy(s->B + i * n_B, r->B, (size_t)n_B * sizeof(double));
        reaction_of_real(p, r, r->lam, r->reaction);
        force_at_real(p, r, s->of_loads + i * p->n_factors, r->q, r->v);
        memset(R, 0, (size_t)n_q * sizeof(double));
        mass_at_real(p, r, r->q);
        csr_times_real(&p->M, r->A, R);
        for (npy_intp e = 0; e < n_q; e++) {
            R[e] += r->reaction[e] - r->Q[e];
            all += 0 * R[e];
        }
        for (npy_intp e = 0; e < n_lam; e++) {
            Phi[e] /= h * h;
            all += 0 * Phi[e];
        }
        sums[0] += squared_size(n_q, r->A, p->weights);
        sums[1] += squared_size(n_q, r->reaction, p->inverse);
        sums[2] += squared_size(n_q, r->Q, p->inverse);
    }
    return motion_of_stages(s, sums) + all;
}

/* Factorise the exact matrix of all stages, at each its own state. */
static int stages_factorised(stage_step *s)
{
    const plan_real *p = s->plan;
    room_real *r = s->room;
    const npy_int64 *place = s->places;
    double h = s->rules->h;
    int n = STAGES * (int)(p->n_q + p->n_lam), half = (int)s->half;
    s->factorisations++;
    for (int i = 0; i < STAGES; i++) {
        stage_state(s, i);
        stage_instant(s, i);
        linearised_real(p, r, s->of_loads + i * p->n_factors);
        for (int j = 0; j < STAGES; j++) {
            double of_M = s->tableau->squared[i][j], of_v = h * s->tableau->inverse[i][j];
            double of_q = i == j ? h * h : 0;
            for (npy_intp e = 0; e < p->nnz; e++)
                s->K[*place++] = of_M * p->K.values[e] + of_q * r->f_q[e] +
                                 (p->velocity ? of_v * r->f_v[e] : 0);
        }
    }
    memset(s->band, 0, (size_t)n * (3 * (size_t)half + 1) * sizeof(double));
    return band_factor_real(s->gbtrf, n, half, s->size_K, STAGES * p->constraints->n_values, s->K,
                            s->B, s->factors, s->flat, s->band, s->pivots, &s->of_B);
}

/* Scale of an unknown of the band. */
static double stage_scale(const stage_step *s, npy_int64 i)
{
    return i < STAGES * s->plan->n_q ? s->scale[i] : s->of_B * s->scale[i];
}

/* Solve for the change of x and lam, and apply it; returns its size in units of force. */
static double stages_changed(stage_step *s)
{
    const plan_real *p = s->plan;
    npy_intp n_q = p->n_q, n_lam = p->n_lam, n = STAGES * (n_q + n_lam);
    double of_a = 0, of_lam = 0, *A = s->room->A, *change = s->change;
    for (npy_intp e = 0; e < n; e++)
        s->work[e] = stage_scale(s, s->order[e]) * s->R[s->order[e]];
    band_solve_real(s->gbtrs, 'N', (int)n, (int)s->half, 1, s->band, s->pivots, s->work);
    for (npy_intp e = 0; e < n; e++)
        change[s->order[e]] = stage_scale(s, s->order[e]) * s->work[e];
    for (npy_intp e = 0; e < STAGES * n_q; e++)
        s->x[e] -= change[e];
    for (npy_intp e = 0; e < STAGES * n_lam; e++)
        s->lam[e] -= change[STAGES * n_q + e];
    for (int i = 0; i < STAGES; i++) {
        for (npy_intp e = 0; e < n_q; e++) {
            A[e] = 0;
            for (int j = 0; j < STAGES; j++)
                A[e] += s->tableau->squared[i][j] * change[j * n_q + e];
        }
        of_a += squared_size(n_q, A, p->weights);
        memcpy(s->room->B, s->B + i * p->constraints->n_values,
               (size_t)p->constraints->n_values * sizeof(double));
        reaction_of_real(p, s->room, change + STAGES * n_q + i * n_lam, s->room->force);
        of_lam += squared_size(n_q, s->room->force, p->inverse);
    }
    return sqrt(of_a + of_lam);
}

/* Newton's method; `size` is that of the last correction, relative to the motion. */
static int stages_iterated(stage_step *s)
{
    const stage_rules *rules = s->rules;
    double usual = motion_before_stages(s), last = INFINITY, motion = INFINITY;
    double floor = rules->positions * DBL_EPSILON * size_of_real(s->plan->n_q, s->q, s->plan->weights);
    double most = usual > DBL_MIN ? rules->most * usual : INFINITY;
    int known = 0, strained = 0;
    floor /= rules->h * rules->h;
    s->size = INFINITY;
    for (; s->iterations < rules->max_iterations;) {
        double now = stage_residuals(s);
        s->iterations++;
        if (!isfinite(now))
            return STAGES_NOT_FINITE;
        motion = fmin(motion, fmin(most, now));
        int fresh = !known || strained;
        if (fresh && stages_factorised(s))
            return STAGES_SINGULAR;
        strained = fresh ? now > rules->jump * usual : strained;
        double size = s->size = stages_changed(s) / motion;
        if (!isfinite(size))
            return STAGES_DIVERGED;
        double rate = last < INFINITY ? fmin(size / last, 1) : size > 0;
        int stuck = last < INFINITY && rate > rules->slow && size <= rules->round_off + floor / motion;
        double left = size * (fresh ? rate * rate : fmin(rate / (1.001 - rate), 1));
        if (stuck || left <= rules->tolerance) {
            s->stuck = stuck;
            return STAGES_SOLVED;
        }
        known = last == INFINITY || size * pow(rate, rules->more) <= rules->tolerance;
        last = size;
    }
    return STAGES_DIVERGED;
}

/* Room for a step, one pointer behind the other. */
static void *stage_room(stage_step *s)
{
    const plan_real *p = s->plan;
    size_t n = STAGES * (size_t)(p->n_q + p->n_lam);
    size_t band = n * (3 * (size_t)s->half + 1), n_B = STAGES * (size_t)p->constraints->n_values;
    double *at = malloc((4 * n + n_B + (size_t)s->size_K + band + 1) * sizeof(double));
    if (!at)
        return PyErr_NoMemory();
    s->R = at, s->change = s->R + n, s->work = s->change + n, s->B = s->work + n;
    s->K = s->B + n_B, s->band = s->K + s->size_K, s->pivots = (int *)(s->band + band);
    return at;
}

/* Indices from 0 to `most`, as they stand; any number of them where `size` is negative. */
static const npy_int64 *indices_in_place(PyObject *object, npy_intp size, npy_intp most)
{
    PyArrayObject *x = (PyArrayObject *)object;
    if (!object || !PyArray_Check(object) || PyArray_TYPE(x) != NPY_INT64 ||
        !PyArray_ISCARRAY_RO(x) || PyArray_SIZE(x) != size || !within_64(x, most))
        return PyErr_Occurred() ? NULL : (wrong("indices of stages do not fit together"), NULL);
    return PyArray_DATA(x);
}

/* (order, scale, half, flat, factors, places) of the coupled matrix; sets `size_K`. */
static int coupled_taken(PyObject *t, stage_step *s)
{
    const plan_real *p = s->plan;
    npy_intp n = STAGES * (p->n_q + p->n_lam), n_B = STAGES * p->constraints->n_values;
    double *scale, *factors;
    if (!item(t, COUPLED_ITEMS, 0) || !taken_number(item(t, COUPLED_ITEMS, 2), MOST_HALF, &s->half))
        return 0;
    npy_intp any = -1;
    if (!in_place(item(t, COUPLED_ITEMS, 1), 0, 1, &n, &scale) ||
        !in_place(item(t, COUPLED_ITEMS, 4), 0, 1, &any, &factors))
        return 0;
    npy_intp values = PyArray_SIZE((PyArrayObject *)item(t, COUPLED_ITEMS, 4));
    s->size_K = values - 2 * n_B, s->scale = scale, s->factors = factors;
    if (s->size_K != STAGES * STAGES * p->nnz || n > INT_MAX)
        return wrong("the matrix of stages is not that of the plan");
    s->order = indices_in_place(item(t, COUPLED_ITEMS, 0), n, n - 1);
    s->flat = indices_in_place(item(t, COUPLED_ITEMS, 3), values, n * (3 * s->half + 1) - 1);
    s->places = indices_in_place(item(t, COUPLED_ITEMS, 5), s->size_K, s->size_K - 1);
    return s->order && s->flat && s->places;
}

/* (q, v, a, lam) before, x and lam to be overwritten, factors of joints and of loads. */
static int stages_taken(PyObject *const *args, stage_step *s)
{
    const plan_real *p = s->plan;
    npy_intp of_x[] = {STAGES, p->n_q}, of_lam[] = {STAGES, p->n_lam}, any[] = {-1, -1};
    double *x[BEGIN_ITEMS], *tables[2];
    for (int i = 0; i < BEGIN_ITEMS; i++)
        if (!item(args[2], BEGIN_ITEMS, i) ||
            !in_place(item(args[2], BEGIN_ITEMS, i), 0, 1, i < 3 ? of_x + 1 : of_lam + 1, &x[i]))
            return 0;
    npy_intp of_joints[] = {STAGES + 1, p->constraints->n_parts};
    npy_intp of_loads[] = {STAGES + 1, p->n_factors};
    s->q = x[0], s->v = x[1], s->a = x[2], s->lam_before = x[3];
    int good = in_place(args[3], 0, 2, of_x, &s->x) && in_place(args[4], 0, 2, of_lam, &s->lam) &&
               in_place(args[5], 0, 2, p->still ? any : of_joints, &tables[0]) &&
               in_place(args[6], 0, 2, of_loads, &tables[1]);
    s->of_joints = tables[0], s->of_loads = tables[1];
    return good;
}

/* solve_stages(prepared, coupled, state, x, lam, of_joints, of_loads, tableau, rules): how it ends,
 * size of the last correction, and counts. */
static PyObject *py_solve_stages(PyObject *const *args)
{
    static void *gbtrf, *gbtrs;
    Prepared *prepared = PyCapsule_GetPointer(args[0], prepared_name);
    npy_intp of_tableau = sizeof(stage_tableau) / sizeof(double);
    npy_intp of_rules = sizeof(stage_rules) / sizeof(double);
    double *tableau, *rules;
    if (!prepared)
        return NULL;
    stage_step s = {.plan = &prepared->plan, .room = &prepared->room};
    if (!coupled_taken(args[1], &s) || !stages_taken(args, &s) ||
        !in_place(args[7], 0, 1, &of_tableau, &tableau) ||
        !in_place(args[8], 0, 1, &of_rules, &rules))
        return NULL;
    s.tableau = (const stage_tableau *)tableau, s.rules = (const stage_rules *)rules;
    s.gbtrf = (gbtrf_t_real)lapack(&gbtrf, "dgbtrf", "void (int *, int *, int *, int *, ");
    s.gbtrs = (gbtrs_t_real)lapack(&gbtrs, "dgbtrs", "void (char *, int *, int *, int *, int *, ");
    void *memory = s.gbtrf && s.gbtrs ? stage_room(&s) : NULL;
    if (!memory)
        return NULL;
    int ends;
    Py_BEGIN_ALLOW_THREADS
    ends = stages_iterated(&s);
    Py_END_ALLOW_THREADS
    free(memory);
    return Py_BuildValue("id(nnn)", ends, s.size, s.iterations, s.factorisations, s.stuck);
}
