/* Steps of HHT-I3 with Newton's method (docs/theory/05-hht-i3.md), for one scalar type.
 *
 * The formulas, and what stops an iteration, are those of `integrators/hht`: `newton.py` says why.
 * A step that is not solved here is left to them, which find out what is wrong with it, so that
 * nothing has to be told but how many steps were taken.
 */

/* A matrix in compressed sparse rows. */
typedef struct {
    npy_intp n;
    const npy_int32 *first, *columns;
    const T *values;
} NAME(csr);

/* out += M x. */
INLINE void NAME(csr_times)(const NAME(csr) *m, const T *x, T *out)
{
    NAME(csr_alone)(m->n, m->first, m->columns, m->values, x, 1, out);
}

/* Rows of a table of factors, one table for each step: at its end, at its beginning, at the Gauss
 * points of small steps, and the time derivatives there. */
enum { AT_END, AT_START, AT_GAUSS, RATE_AT_GAUSS = AT_GAUSS + 3, ALL_INSTANTS = RATE_AT_GAUSS + 3 };
/* How a march ends: with all steps, or before one that is not solved, that needs factors at Gauss
 * points, whose matrix is indefinite, or that no time is left for. */
enum { ALL_TAKEN, NOT_SOLVED, NEEDS_GAUSS, INDEFINITE, OUT_OF_TIME };

/* Corrections from a guess close to the solution shrink by this factor at least (`_CLOSE`). */
#ifndef CLOSE
#define CLOSE 0.5
#endif

/* A load that moves, and whether it uses velocities. */
typedef struct {
    const load_plan *plan;
    NAME(load_numbers) numbers;
    int velocity;
} NAME(moving_load);

/* A system of lists of operations in place of elements, joints and loads. All lists take t, q, v, A,
 * lam and b: Phi_q, Phi, dPhi/dt, Q, M, and f_q with f_v behind it where forces use velocities. */
enum { OF_JACOBIAN, OF_PLACE, OF_RATE, OF_FORCE, OF_MASS, OF_TANGENTS, MARCH_LISTS };

typedef struct {
    const operation_list *of[MARCH_LISTS];
    const T *constants[MARCH_LISTS], *b;
    npy_intp n_b;
} NAME(listed);

/* A system with its matrices and the settings of Newton's method. `first` is NULL without an
 * envelope, `fronts` without these, `flat` without a band; `chosen`, `places` and `signs` belong to
 * the envelope or to the fronts. Factors are those of all loads, `velocity` tells whether forces
 * depend on it; coefficients of joints that are `still` are the same at all
 * instants. */
typedef struct {
    npy_intp n_q, n_lam, nnz, n_loads, n_moving, n_factors, n_chosen, half;
    int n_y, d, damped, velocity, still;
    NAME(block) block;
    const constraint_plan *constraints;
    const NAME(moving_load) *moving;
    NAME(constraint_numbers) numbers;
    NAME(csr) M, K, B; /* K has the values of M on the pattern of all tangents */
    const npy_int32 *index, *first, *chosen, *places;
    const npy_int64 *order, *flat;
    const fronts *fronts;
    const NAME(listed) *listed; /* NULL for a scene; its factors are the times */
    const T *gravity, *loads;
    const double *weights, *inverse, *signs, *scale, *factors;
    NAME(gbtrf_t) gbtrf;
    NAME(gbtrs_t) gbtrs;
    march_rules rules;
} NAME(plan);

/* Room for what an iteration writes. `ahead` holds dq of a small step; coefficients c belong to the
 * end of the step, those in `within` to instants in it, U to vectors of one joint. */
enum { BY_ENVELOPE, BY_BAND, BY_FRONTS };

typedef struct {
    T *q_p, *dq_p, *v_p, *q, *v, *A, *a, *lam, *U, *B, *Q, *inner, *reaction, *ahead, *start;
    T *Phi, *rate, *defect, *R, *x, *force, *f_q, *f_v, *sum, *matrix, *work;
    T *at_end, *within, *of_load, *numbers, *mass;
    const T *c[1];
    double *least, of_B;
    front_room in_fronts;
    int *pivots, B_known, factored; /* How: by an envelope, by a band or by fronts. */
    npy_intp counts[3]; /* iterations, factorisations, steps that round-off disturbs */
} NAME(room);

/* The state before a step. */
typedef struct {
    const T *q, *v, *a, *lam, *A;
    double motion;
} NAME(before);

INLINE double NAME(size_of)(npy_intp n, const T *x, const double *weights)
{
    double sum = 0;
    for (npy_intp i = 0; i < n; i++)
        sum += weights[i] * creal(x[i]) * creal(x[i]);
    return sqrt(sum);
}

/* Outputs of a list at a state, of which it reads what is given. */
static void NAME(listed_at)(const NAME(plan) *p, NAME(room) *r, int which, T t, const T *q,
                            const T *v, const T *A, const T *lam, T *out, npy_intp count)
{
    const NAME(listed) *s = p->listed;
    const operation_list *of = s->of[which];
    const T *parts[] = {&t, q, v, A, lam, s->b, s->constants[which]};
    npy_intp sizes[] = {1, p->n_q, p->n_q, p->n_q, p->n_lam, s->n_b, of->n_constants};
    T *to = r->numbers;
    for (int i = 0; i < 7; to += sizes[i++])
        if (parts[i])
            memcpy(to, parts[i], (size_t)sizes[i] * sizeof(T));
    NAME(list_evaluated)(of, 1, r->numbers);
    for (npy_intp i = 0; i < count; i++)
        out[i] = r->numbers[of->outputs[i]];
}

/* M, which moves in a system of lists. */
static void NAME(mass_at)(const NAME(plan) *p, NAME(room) *r, const T *q)
{
    if (p->listed)
        NAME(listed_at)(p, r, OF_MASS, 0, q, NULL, NULL, NULL, r->mass, p->nnz);
}

/* Phi_q on its pattern. */
static void NAME(jacobian_at)(const NAME(plan) *p, NAME(room) *r, const T *const *c, const T *q)
{
    const T *X[] = {q};
    if (p->listed) {
        NAME(listed_at)(p, r, OF_JACOBIAN, *c[0], q, NULL, NULL, NULL, r->B, p->constraints->n_values);
        return;
    }
    if (r->B_known)
        return;
    memset(r->B, 0, (size_t)p->constraints->n_values * sizeof(T));
    NAME(constraints)(p->constraints, p->numbers.l, VALUES, 0, c, X, NULL, r->U, r->B);
    r->B_known = p->still && p->constraints->n_s == 0;
}

/* Phi, or its first time derivative along v. */
static void NAME(constraint_at)(const NAME(plan) *p, NAME(room) *r, const T *const *c, const T *q,
                                const T *v, T *Phi)
{
    const T *X[] = {q, v};
    if (p->listed) {
        NAME(listed_at)(p, r, v ? OF_RATE : OF_PLACE, *c[0], q, v, NULL, NULL, Phi, p->n_lam);
        return;
    }
    memset(Phi, 0, (size_t)p->n_lam * sizeof(T));
    NAME(constraints)(p->constraints, p->numbers.l, RATE, v ? 1 : 0, c, X, NULL, r->U, Phi);
}

/* Coefficients from a row of factors, and their rates from the third row on where asked for. */
static void NAME(at_instant)(const NAME(plan) *p, NAME(room) *r, const double *factors, int instant,
                             int rates, const T **c)
{
    c[0] = p->listed ? factors + instant : p->numbers.part_0;
    c[rates] = rates ? NULL : c[0];
    if (p->listed)
        return;
    if (!p->still)
        NAME(coefficients)(p->constraints, &p->numbers, rates, 0, RATE_AT_GAUSS - AT_GAUSS,
                           factors + instant * p->constraints->n_parts, r->within, c);
}

/* out = Phi_q^T lam with the Jacobian as it stands. */
static void NAME(reaction_of)(const NAME(plan) *p, const NAME(room) *r, const T *lam, T *out)
{
    memset(out, 0, (size_t)p->n_q * sizeof(T));
    NAME(csr_rows_transposed)(p->n_lam, p->B.first, p->B.columns, r->B, 1, lam, 1, p->n_q, out);
}

static void NAME(force_at)(const NAME(plan) *p, NAME(room) *r, const double *factors, const T *q,
                           const T *v)
{
    if (p->listed) {
        NAME(listed_at)(p, r, OF_FORCE, factors[0], q, v, NULL, NULL, r->Q, p->n_q);
        return;
    }
    memset(r->inner, 0, (size_t)p->n_q * sizeof(T));
    NAME(forces)(p->n_y, p->d, &p->block, q, p->damped ? v : NULL, r->inner);
    for (npy_intp i = 0; i < p->n_q; i++)
        r->Q[i] = p->gravity[i] - r->inner[i];
    for (npy_intp k = 0; k < p->n_loads; k++)
        for (npy_intp i = 0; i < p->n_q; i++)
            r->Q[i] += factors[k] * p->loads[k * p->n_q + i];
    for (npy_intp k = 0; k < p->n_moving; k++)
        NAME(load_force)(p->moving[k].plan, &p->moving[k].numbers, factors[p->n_loads + k], q, v,
                         r->of_load, r->Q);
}

/* Phi = defect + its integral over a small step along dq. */
static void NAME(constraint_over)(const NAME(plan) *p, NAME(room) *r, double h,
                                  const double *factors, const T *q, const T *dq, T *Phi)
{
    const T *c[2];
    memcpy(Phi, r->defect, (size_t)p->n_lam * sizeof(T));
    for (int k = 0; k < 3; k++) {
        for (npy_intp i = 0; i < p->n_q; i++) {
            r->x[i] = q[i] + p->rules.places[k] * dq[i];
            r->force[i] = dq[i] / h;
        }
        NAME(at_instant)(p, r, factors, AT_GAUSS + k, 1, c);
        NAME(constraint_at)(p, r, c, r->x, r->force, r->rate);
        for (npy_intp i = 0; i < p->n_lam; i++)
            Phi[i] += p->rules.weights[k] * h * r->rate[i];
    }
}

static double NAME(motion_of)(const NAME(plan) *p, const NAME(room) *r, const T *a)
{
    double size = NAME(size_of)(p->n_q, a, p->weights) +
                  NAME(size_of)(p->n_q, r->reaction, p->inverse) +
                  NAME(size_of)(p->n_q, r->Q, p->inverse);
    double least = fmax(p->rules.blur, DBL_MIN);
    return size < least ? least : size; /* also what is not a number */
}

static double NAME(motion_before)(const NAME(plan) *p, NAME(room) *r, const NAME(before) *b,
                                  const double *of_joints, const double *of_loads)
{
    if (b->motion < INFINITY)
        return b->motion;
    const T *c[1];
    NAME(at_instant)(p, r, of_joints, AT_START, 0, c);
    NAME(jacobian_at)(p, r, c, b->q);
    NAME(reaction_of)(p, r, b->lam, r->reaction);
    NAME(force_at)(p, r, of_loads + AT_START * p->n_factors, b->q, b->v);
    return NAME(motion_of)(p, r, b->a);
}

/* Coordinates, velocities and accelerations that belong to a (eqs. 2, 3). */
static void NAME(state_of)(const NAME(plan) *p, const NAME(room) *r, const step_coefficients *c,
                           const T *A_n, const T *a, T *q, T *v, T *A)
{
    for (npy_intp i = 0; i < p->n_q; i++) {
        q[i] = r->q_p[i] + c->in_q * a[i];
        v[i] = r->v_p[i] + c->in_v * a[i];
        A[i] = (c->alpha * c->in_A) * A_n[i] + c->in_A * a[i];
    }
}

static void NAME(predict)(const NAME(plan) *p, NAME(room) *r, const step_coefficients *c,
                          const NAME(before) *b)
{
    double of_a = c->h * (1 - c->gamma), of_dq = c->h * c->h * (c->gamma - 0.5 - c->beta);
    for (npy_intp i = 0; i < p->n_q; i++) {
        r->v_p[i] = b->v[i] + of_a * b->a[i];
        r->dq_p[i] = c->h * r->v_p[i] + of_dq * b->a[i];
        r->q_p[i] = b->q[i] + r->dq_p[i];
    }
}

/* The guess of a: a step ahead where the line through a and A is smooth. */
static void NAME(look_ahead)(const NAME(plan) *p, NAME(room) *r, const NAME(before) *b,
                             double motion)
{
    double times = p->rules.alpha ? fmin(-1 / p->rules.alpha, p->rules.ahead) : 0;
    for (npy_intp i = 0; i < p->n_q; i++)
        r->a[i] = b->A[i] - b->a[i];
    if (times * NAME(size_of)(p->n_q, r->a, p->weights) > p->rules.smooth * motion)
        times = 0;
    for (npy_intp i = 0; i < p->n_q; i++)
        r->a[i] = b->a[i] + times * r->a[i];
    memcpy(r->lam, b->lam, (size_t)p->n_lam * sizeof(T));
}

/* The residual of eqs. (4) and (5) at a and lam; whether it is finite. */
static int NAME(residual_at)(const NAME(plan) *p, NAME(room) *r, const step_coefficients *c,
                             const NAME(before) *b, const double *of_joints,
                             const double *of_loads, int small)
{
    T sum = 0, *R = r->R;
    NAME(state_of)(p, r, c, b->A, r->a, r->q, r->v, r->A);
    if (small) {
        for (npy_intp i = 0; i < p->n_q; i++)
            r->ahead[i] = r->dq_p[i] + c->in_q * r->a[i];
        NAME(constraint_over)(p, r, c->h, of_joints, b->q, r->ahead, r->Phi);
    }
    if (!small)
        NAME(constraint_at)(p, r, r->c, r->q, NULL, r->Phi);
    NAME(jacobian_at)(p, r, r->c, r->q);
    NAME(reaction_of)(p, r, r->lam, r->reaction);
    NAME(force_at)(p, r, of_loads + AT_END * p->n_factors, r->q, r->v);
    memset(R, 0, (size_t)p->n_q * sizeof(T));
    NAME(mass_at)(p, r, r->q);
    NAME(csr_times)(&p->M, r->A, R);
    for (npy_intp i = 0; i < p->n_q; i++) {
        R[i] += r->reaction[i] - r->Q[i];
        sum += 0 * R[i];
    }
    for (npy_intp i = 0; i < p->n_lam; i++) {
        R[p->n_q + i] = (1 / c->in_q) * r->Phi[i];
        sum += 0 * R[p->n_q + i];
    }
    return sum == 0;
}

/* Factorise eq. (6) in a band, from values as below: 0 or NOT_SOLVED. */
static int NAME(banded_sum)(const NAME(plan) *p, NAME(room) *r, const step_coefficients *c,
                            const T *f_q, const T *f_v, const T *B)
{
    npy_intp n = p->n_q + p->n_lam, n_B = p->constraints->n_values;
    for (npy_intp i = 0; i < p->nnz; i++)
        r->sum[i] = c->in_A * p->K.values[i] + c->in_q * f_q[i];
    for (npy_intp i = 0; f_v && i < p->nnz; i++)
        r->sum[i] += c->in_v * f_v[i];
    r->factored = BY_BAND;
    memset(r->matrix, 0, (size_t)n * (3 * (size_t)p->half + 1) * sizeof(T));
    return NAME(band_factor)(p->gbtrf, (int)n, (int)p->half, p->nnz, n_B, r->sum, B, p->factors,
                             p->flat, r->matrix, r->pivots, &r->of_B)
               ? NOT_SOLVED
               : 0;
}

/* Factorise eq. (6) by fronts, from values as below: 0 or NOT_SOLVED. */
static int NAME(sum_in_fronts)(const NAME(plan) *p, NAME(room) *r, const step_coefficients *c,
                               const T *f_q, const T *B)
{
    front_room *x = &r->in_fronts;
    memset(x->a, 0, (size_t)p->fronts->column_at[p->fronts->n] * sizeof *x->a);
    NAME(ldl_placed)(p->n_chosen, p->chosen, p->places, c->in_A, p->K.values, x->a);
    NAME(ldl_placed)(p->n_chosen, p->chosen, p->places, c->in_q, f_q, x->a);
    NAME(ldl_placed)(p->constraints->n_values, NULL, p->places + p->n_chosen, 1, B, x->a);
    r->factored = BY_FRONTS;
    return fronts_factored(p->fronts, x, r->matrix) ? NOT_SOLVED : 0;
}

/* Factorise eq. (6) from values of f_q, f_v, NULL where there is none, and Phi_q: 0, NOT_SOLVED, or
 * INDEFINITE. */
static int NAME(factor_sum)(const NAME(plan) *p, NAME(room) *r, const step_coefficients *c,
                            const T *f_q, const T *f_v, const T *B)
{
    npy_intp n = p->n_q + p->n_lam, n_B = p->constraints->n_values;
    if (p->first && !f_v) {
        memset(r->matrix, 0, (size_t)p->first[n] * sizeof(T));
        NAME(ldl_placed)(p->n_chosen, p->chosen, p->places, c->in_A, p->K.values, r->matrix);
        NAME(ldl_placed)(p->n_chosen, p->chosen, p->places, c->in_q, f_q, r->matrix);
        NAME(ldl_placed)(n_B, NULL, p->places + p->n_chosen, 1, B, r->matrix);
        if (NAME(ldl_factor)(n, p->first, p->signs, r->matrix, r->least) == 0)
            return r->factored = BY_ENVELOPE;
    }
    if (p->fronts)
        return f_v ? NOT_SOLVED : NAME(sum_in_fronts)(p, r, c, f_q, B);
    return p->flat ? NAME(banded_sum)(p, r, c, f_q, f_v, B) : INDEFINITE;
}

/* Subtract Q_q, or Q_v, of loads that move. */
static void NAME(load_tangents)(const NAME(plan) *p, NAME(room) *r, const double *factors,
                                int velocity, T *values)
{
    for (npy_intp k = 0; k < p->n_moving; k++)
        if (!velocity || p->moving[k].velocity)
            NAME(load_tangent)(p->moving[k].plan, &p->moving[k].numbers, -factors[p->n_loads + k],
                               r->q, r->v, velocity, r->of_load, values);
}

/* Values of f_q and f_v at the state as it stands, from a row of factors of loads. */
static void NAME(linearised)(const NAME(plan) *p, NAME(room) *r, const double *factors)
{
    const T *v = p->damped ? r->v : NULL;
    if (p->listed) {
        /* f_v stands behind f_q. */
        NAME(listed_at)(p, r, OF_TANGENTS, factors[0], r->q, r->v, r->A, r->lam, r->f_q,
                        p->velocity ? 2 * p->nnz : p->nnz);
        NAME(mass_at)(p, r, r->q);
        return;
    }
    memset(r->f_q, 0, (size_t)p->nnz * sizeof(T));
    NAME(tangents)(p->n_y, p->d, &p->block, r->q, v, 0, p->index, p->nnz, r->f_q);
    NAME(constraint_curvature)(p->constraints, p->numbers.l, r->c[0], r->lam, r->f_q);
    NAME(load_tangents)(p, r, factors, 0, r->f_q);
    if (!p->velocity)
        return;
    memset(r->f_v, 0, (size_t)p->nnz * sizeof(T));
    if (p->damped)
        NAME(tangents)(p->n_y, p->d, &p->block, r->q, NULL, 1, p->index, p->nnz, r->f_v);
    NAME(load_tangents)(p, r, factors, 1, r->f_v);
}

/* Factorise eq. (6) at the state as it stands. */
static int NAME(factorised)(const NAME(plan) *p, NAME(room) *r, const step_coefficients *c,
                            const double *of_loads)
{
    r->counts[1]++;
    NAME(linearised)(p, r, of_loads + AT_END * p->n_factors);
    return NAME(factor_sum)(p, r, c, r->f_q, p->velocity ? r->f_v : NULL, r->B);
}

/* Scale of an unknown of the band. */
INLINE double NAME(band_scale)(const NAME(plan) *p, const NAME(room) *r, npy_int64 i)
{
    return i < p->n_q ? p->scale[i] : r->of_B * p->scale[i];
}

/* x = J^-1 right, or its transpose, for rows: 0, or NOT_SOLVED where refinement does not converge. */
static int NAME(solve_rows)(const NAME(plan) *p, NAME(room) *r, char how, npy_intp rows,
                             const T *right, T *x)
{
    npy_intp n = p->n_q + p->n_lam;
    if (r->factored == BY_FRONTS)
        return fronts_solve(p->fronts, r->in_fronts.a, r->matrix, p->order, r->in_fronts.scale, rows,
                            1, right, r->work, x) <= UNREFINED
                   ? 0
                   : NOT_SOLVED;
    if (r->factored == BY_ENVELOPE) {
        NAME(ldl_solve)(n, p->first, r->matrix, p->order, rows, 1, right, r->work, x);
        return 0;
    }
    for (; rows > 0; rows--, right += n, x += n) {
        for (npy_intp i = 0; i < n; i++)
            r->work[i] = NAME(band_scale)(p, r, p->order[i]) * right[p->order[i]];
        NAME(band_solve)(p->gbtrs, how, (int)n, (int)p->half, 1, r->matrix, r->pivots, r->work);
        for (npy_intp i = 0; i < n; i++)
            x[p->order[i]] = NAME(band_scale)(p, r, p->order[i]) * r->work[i];
    }
    return 0;
}

/* Whether round-off of elastic forces leaves less than seven digits of the motion. */
static int NAME(blurred)(const NAME(plan) *p, NAME(room) *r)
{
    if (NAME(size_of)(p->n_q, r->a, p->weights) >= p->rules.blur)
        return 0;
    NAME(reaction_of)(p, r, r->lam, r->force);
    return NAME(size_of)(p->n_q, r->force, p->inverse) < p->rules.blur;
}

/* The residual at the guess a, or where that is far from balance at the state before the step, as
 * `_from_rest` in `newton.py`; `close` tells whether corrections must shrink quickly then. */
static int NAME(residual_at_guess)(const NAME(plan) *p, NAME(room) *r, const step_coefficients *c,
                                   const NAME(before) *b, const double *of_joints,
                                   const double *of_loads, int small, double motion, int *close)
{
    int finite = NAME(residual_at)(p, r, c, b, of_joints, of_loads, small);
    double unbalanced = NAME(size_of)(p->n_q, r->R, p->inverse);
    *close = !(unbalanced <= p->rules.jump * motion);
    if (!*close)
        return finite;
    for (npy_intp i = 0; i < p->n_q; i++)
        r->a[i] = -r->dq_p[i] / c->in_q;
    finite = NAME(residual_at)(p, r, c, b, of_joints, of_loads, small);
    *close = !(NAME(size_of)(p->n_q, r->R, p->inverse) > p->rules.smooth * unbalanced);
    if (*close)
        return finite;
    NAME(look_ahead)(p, r, b, motion);
    return NAME(residual_at)(p, r, c, b, of_joints, of_loads, small);
}

/* Newton's method for one step; the solution stands in a and lam. */
static int NAME(iterated)(const NAME(plan) *p, NAME(room) *r, const step_coefficients *c,
                          const NAME(before) *b, const double *of_joints, const double *of_loads,
                          int small, double motion_before, double *motion_after)
{
    double last = INFINITY;
    double motion = motion_before > DBL_MIN ? p->rules.jump * motion_before : INFINITY;
    int fresh = 1, close = 0;
    for (npy_intp i = 0; i < p->rules.max_iterations; i++) {
        r->counts[0]++;
        if (!(i ? NAME(residual_at)(p, r, c, b, of_joints, of_loads, small)
                : NAME(residual_at_guess)(p, r, c, b, of_joints, of_loads, small, motion_before,
                                          &close)))
            return NOT_SOLVED;
        int failed = fresh ? NAME(factorised)(p, r, c, of_loads) : 0;
        if (failed || (failed = NAME(solve_rows)(p, r, 'N', 1, r->R, r->x)))
            return failed;
        for (npy_intp k = 0; k < p->n_q; k++)
            r->a[k] -= r->x[k];
        for (npy_intp k = 0; k < p->n_lam; k++)
            r->lam[k] -= r->x[p->n_q + k];
        double now = NAME(motion_of)(p, r, r->a);
        motion = now < motion ? now : motion;
        NAME(reaction_of)(p, r, r->x + p->n_q, r->force);
        double size = (NAME(size_of)(p->n_q, r->x, p->weights) +
                       NAME(size_of)(p->n_q, r->force, p->inverse)) / motion;
        double rate = last > 0 && last < INFINITY ? fmin(size / last, 1) : size > 0;
        if (close && last < INFINITY && size > p->rules.round_off && rate > CLOSE)
            return NOT_SOLVED;
        int stuck = fresh && rate > 0.5 && size <= p->rules.round_off &&
                    NAME(size_of)(p->n_q, r->R, p->inverse) <= p->rules.round_off * now;
        double left = size * (fresh ? fmin(1, rate * rate) : rate / fmax(1 - rate, 1e-3));
        if (stuck || left <= p->rules.tolerance || size <= p->rules.tolerance) {
            r->counts[2] += stuck || NAME(blurred)(p, r);
            *motion_after = now;
            return 0;
        }
        if (last < INFINITY)
            fresh = rate > p->rules.slow || (size < p->rules.near && size * (rate * rate * rate) > p->rules.tolerance);
        else
            fresh = size > p->rules.slow;
        last = size;
    }
    return NOT_SOLVED;
}

/* One step from b; of the state after it a stays in the room. */
static int NAME(stepped)(const NAME(plan) *p, NAME(room) *r, const step_coefficients *c,
                         const NAME(before) *b, const double *of_joints, npy_intp instants,
                         const double *of_loads, double *motion_after)
{
    double motion = NAME(motion_before)(p, r, b, of_joints, of_loads);
    double noise = DBL_EPSILON * NAME(size_of)(p->n_q, b->q, p->weights);
    double allowed = p->rules.quiet * motion * c->in_q;
    int small = p->n_lam && !(noise <= allowed);
    if (small && instants < ALL_INSTANTS)
        return NEEDS_GAUSS;
    NAME(predict)(p, r, c, b);
    NAME(look_ahead)(p, r, b, motion);
    if (small) {
        const T *at_start[1];
        NAME(at_instant)(p, r, of_joints, AT_START, 0, at_start);
        NAME(constraint_at)(p, r, at_start, b->q, NULL, r->defect);
        for (npy_intp i = 0; i < p->n_lam; i++)
            r->defect[i] *= allowed / noise;
    }
    r->c[0] = p->listed ? of_joints + AT_END : p->numbers.part_0;
    if (!p->still && !p->listed)
        NAME(coefficients)(p->constraints, &p->numbers, 0, 0, 1,
                           of_joints + AT_END * p->constraints->n_parts, r->at_end, r->c);
    return NAME(iterated)(p, r, c, b, of_joints, of_loads, small, motion, motion_after);
}

/* As many of k steps of sizes h as can be taken until the clock says so; the states after them are
 * rows of q, v, A and lam. Tables of factors have `instants` rows of joints, two of loads, or are
 * empty. `ends` tells why no more are taken; what stands in b belongs to the last state then. */
static npy_intp NAME(marched)(const NAME(plan) *p, NAME(room) *r, NAME(before) *b, npy_intp k,
                              const double *h, npy_intp instants, const double *of_joints,
                              const double *of_loads, double until, T *const out[4], T *a, int *ends)
{
    npy_intp sizes[] = {p->n_q, p->n_q, p->n_q, p->n_lam}, n_q = p->n_q;
    for (npy_intp n = 0; n < k; n++) {
        step_coefficients c = coefficients_of_step(h[n], p->rules.alpha);
        npy_intp counts[3];
        double motion = 0, ratio = n ? h[n] / h[n - 1] : 1;
        if (n && seconds_now() > until)
            return *ends = OUT_OF_TIME, n;
        NAME(before) begin = *b;
        if (ratio != 1) {
            for (npy_intp i = 0; i < n_q; i++)
                r->start[i] = b->A[i] + ratio * (b->a[i] - b->A[i]);
            begin.a = r->start;
        }
        memcpy(counts, r->counts, sizeof counts);
        *ends = NAME(stepped)(p, r, &c, &begin, of_joints + n * instants * p->constraints->n_parts,
                              instants, of_loads + n * 2 * p->n_factors, &motion);
        if (*ends) {
            memcpy(r->counts, counts, sizeof counts);
            return n;
        }
        T *row[4];
        for (int i = 0; i < 4; i++)
            row[i] = out[i] + n * sizes[i];
        NAME(state_of)(p, r, &c, b->A, r->a, row[0], row[1], row[2]);
        memcpy(row[3], r->lam, (size_t)p->n_lam * sizeof(T));
        memcpy(a, r->a, (size_t)n_q * sizeof(T));
        NAME(before) after = {row[0], row[1], a, row[3], row[2], motion};
        *b = after;
    }
    *ends = ALL_TAKEN;
    return k;
}
