/* Newton's method for the three stages of a step of Radau IIA, for one scalar type.
 *
 * `integrators/radau/stages.py` states the equations, and `newton.py` there has the rules with their
 * reasons. The matrix is real.
 */

enum { STAGES = 3 };
/* How it ends. */
enum { STAGES_SOLVED, STAGES_DIVERGED, STAGES_NOT_FINITE, STAGES_SINGULAR };

/* Places c, A^-1 and A^-2. */
struct StageTableau {
    double c[STAGES], inverse[STAGES][STAGES], squared[STAGES][STAGES];
};

/* Size of the step and the numbers of `newton.py`. */
struct StageRules {
    double h, tolerance, max_iterations, least, more, jump, most, slow, round_off, positions;
};

/* The real coupled matrix of all stages, in a band or by a solver (nullptr without one): places of its
 * values, and room. Scaled rows of solutions have `of_B` for multipliers. */
struct StageMatrix {
    const double *scale, *factors;
    const int64_t *order, *flat, *places;
    Gbtrf<double> gbtrf;
    Gbtrs<double> gbtrs;
    MatrixSolver *solver;
    Size half, size_K;
    double *B, *K, *band, *work, of_B;
    int *pivots;
};

/* A step: where it begins, what is solved for, and room. R and `change` have the coordinates of all
 * stages, then their multipliers. */
template <class T> struct StageStep {
    const Plan<T> *plan;
    Room<T> *room;
    const StageTableau *tableau;
    const StageRules *rules;
    StageMatrix *matrix;
    const T *q, *v, *a, *lam_before, *of_joints, *of_loads;
    Size iterations, factorisations, stuck;
    T *x, *lam, *R, *change, *B;
    double size;
};

/* Position, velocity and acceleration of stage i, and coefficients of joints, in the room. */
template <class T> void stage_state(const StageStep<T> *s, int i)
{
    const Plan<T> *p = s->plan;
    Room<T> *r = s->room;
    double h = s->rules->h;
    for (Size e = 0; e < p->n_q; e++) {
        T V = 0, A = 0;
        for (int j = 0; j < STAGES; j++) {
            V += s->tableau->inverse[i][j] * s->x[j * p->n_q + e];
            A += s->tableau->squared[i][j] * s->x[j * p->n_q + e];
        }
        r->q[e] = s->q[e] + h * s->tableau->c[i] * s->v[e] + h * h * s->x[i * p->n_q + e];
        r->v[e] = s->v[e] + h * V;
        r->A[e] = A;
    }
    memcpy(r->lam, s->lam + i * p->n_lam, (size_t)p->n_lam * sizeof(T));
}

/* Coefficients of joints at an instant, of which 3 is the start of the step. */
template <class T> void stage_instant(const StageStep<T> *s, int i)
{
    const Plan<T> *p = s->plan;
    s->room->c[0] = p->own ? s->of_joints + i : p->numbers.part_0;
    if (!p->still && !p->own)
        coefficients<T>(p->constraints, &p->numbers, 0, 0, 1,
                             s->of_joints + i * p->constraints->n_parts, s->room->at_end,
                             s->room->c);
}

template <class T> double squared_size(Size n, const T *x, const double *weights)
{
    double size = size_of<T>(n, x, weights);
    return size * size;
}

/* Sizes of accelerations, reactions and forces of all stages together. */
template <class T> double motion_of_stages(const StageStep<T> *s, const double sums[3])
{
    return fmax(sqrt(sums[0]) + sqrt(sums[1]) + sqrt(sums[2]), s->rules->least);
}

/* Size of the motion at three stages like the start. */
template <class T> double motion_before_stages(const StageStep<T> *s)
{
    const Plan<T> *p = s->plan;
    Room<T> *r = s->room;
    stage_instant<T>(s, STAGES);
    jacobian_at<T>(p, r, r->c, s->q);
    reaction_of<T>(p, r, s->lam_before, r->reaction);
    force_at<T>(p, r, s->of_loads + STAGES * p->n_factors, s->q, s->v);
    const double sums[] = {STAGES * squared_size<T>(p->n_q, s->a, p->weights),
                           STAGES * squared_size<T>(p->n_q, r->reaction, p->inverse),
                           STAGES * squared_size<T>(p->n_q, r->Q, p->inverse)};
    return motion_of_stages<T>(s, sums);
}

/* Residuals of all stages and Phi_q there; returns the size of the motion, NaN where one is. */
template <class T> double stage_residuals(StageStep<T> *s)
{
    const Plan<T> *p = s->plan;
    Room<T> *r = s->room;
    Size n_q = p->n_q, n_lam = p->n_lam, n_B = p->constraints->n_values;
    double sums[3] = {0, 0, 0}, h = s->rules->h;
    T all = 0;
    for (int i = 0; i < STAGES; i++) {
        T *R = s->R + i * n_q, *Phi = s->R + STAGES * n_q + i * n_lam;
        stage_state<T>(s, i);
        stage_instant<T>(s, i);
        constraint_at<T>(p, r, r->c, r->q, nullptr, Phi);
        jacobian_at<T>(p, r, r->c, r->q);
        memcpy(s->B + i * n_B, r->B, (size_t)n_B * sizeof(T));
        reaction_of<T>(p, r, r->lam, r->reaction);
        force_at<T>(p, r, s->of_loads + i * p->n_factors, r->q, r->v);
        memset(R, 0, (size_t)n_q * sizeof(T));
        mass_at<T>(p, r, r->q);
        csr_times<T>(&p->M, r->A, R);
        for (Size e = 0; e < n_q; e++) {
            R[e] += r->reaction[e] - r->Q[e];
            all += 0 * R[e];
        }
        for (Size e = 0; e < n_lam; e++) {
            Phi[e] /= h * h;
            all += 0 * Phi[e];
        }
        sums[0] += squared_size<T>(n_q, r->A, p->weights);
        sums[1] += squared_size<T>(n_q, r->reaction, p->inverse);
        sums[2] += squared_size<T>(n_q, r->Q, p->inverse);
    }
    return motion_of_stages<T>(s, sums) + real_part(all) + imaginary_part(all);
}

/* Blocks (i, j) of the coupled matrix, for all j, from values of M, f_q and f_v, nullptr for none, of
 * stage i. */
void stage_blocks(StageMatrix *m, const StageTableau *tableau, double h, int i, Size nnz,
                  const double *M, const double *f_q, const double *f_v)
{
    const int64_t *place = m->places + i * STAGES * nnz;
    for (int j = 0; j < STAGES; j++) {
        double of_M = tableau->squared[i][j], of_v = h * tableau->inverse[i][j];
        double of_q = i == j ? h * h : 0;
        for (Size e = 0; e < nnz; e++)
            m->K[*place++] = of_M * M[e] + of_q * f_q[e] + (f_v ? of_v * f_v[e] : 0);
    }
}

/* Factorise the coupled matrix of n unknowns as it stands: whether it is singular. */
bool stage_matrix_singular(StageMatrix *m, Size n, Size n_B)
{
    const double one = 1;
    if (m->solver)
        return m->solver->fails(1, &one, &m->K, m->B);
    memset(m->band, 0, (size_t)n * (3 * (size_t)m->half + 1) * sizeof(double));
    return band_factor<double>(m->gbtrf, (int)n, (int)m->half, m->size_K, n_B, m->K, m->B,
                               m->factors, m->flat, m->band, m->pivots, &m->of_B) != 0;
}

/* Factorise the exact matrix of all stages, at the real part of the state of each: whether it is
 * singular. */
template <class T> bool stages_singular(StageStep<T> *s)
{
    const Plan<T> *p = s->plan;
    StageMatrix *m = s->matrix;
    Size n_B = STAGES * p->constraints->n_values;
    s->factorisations++;
    for (int i = 0; i < STAGES; i++) {
        stage_state<T>(s, i);
        stage_instant<T>(s, i);
        auto [real, r, of_loads] = real_state(p, s->room, s->of_loads + i * p->n_factors);
        linearised(real, r, of_loads);
        stage_blocks(m, s->tableau, s->rules->h, i, p->nnz, real->K.values, r->f_q,
                     p->velocity ? r->f_v : nullptr);
    }
    for (Size e = 0; e < n_B; e++)
        m->B[e] = real_part(s->B[e]);
    return stage_matrix_singular(m, STAGES * (p->n_q + p->n_lam), n_B);
}

/* Scale of an unknown of the band, of which the first n_q are coordinates. */
double stage_scale(const StageMatrix *m, Size n_q, int64_t i)
{
    return i < n_q ? m->scale[i] : m->of_B * m->scale[i];
}

/* Rows of solutions for rows of right sides, in place; the work has room for a row. */
void stages_solved(StageMatrix *m, bool transposed, Size n_q, Size n, Size rows, double *x)
{
    for (Size i = 0; i < rows; i++, x += n) {
        if (m->solver) {
            m->solver->solve(transposed, 1, x, x);
            continue;
        }
        for (Size e = 0; e < n; e++)
            m->work[e] = stage_scale(m, n_q, m->order[e]) * x[m->order[e]];
        band_solve<double>(m->gbtrs, transposed ? 'T' : 'N', (int)n, (int)m->half, 1, m->band,
                           m->pivots, m->work);
        for (Size e = 0; e < n; e++)
            x[m->order[e]] = stage_scale(m, n_q, m->order[e]) * m->work[e];
    }
}

/* Solve for the change of x and lam, and apply it; returns its size in units of force. */
template <class T> double stages_changed(StageStep<T> *s)
{
    const Plan<T> *p = s->plan;
    Size n_q = p->n_q, n_lam = p->n_lam, n = STAGES * (n_q + n_lam);
    double of_a = 0, of_lam = 0, *rows = s->matrix->work + n;
    T *A = s->room->A, *change = s->change;
    parted<T>(n, s->R, rows);
    stages_solved(s->matrix, false, STAGES * n_q, n, PARTS<T>, rows);
    for (Size e = 0; e < n; e++)
        change[e] = joined(rows + e, n, T(0));
    for (Size e = 0; e < STAGES * n_q; e++)
        s->x[e] -= change[e];
    for (Size e = 0; e < STAGES * n_lam; e++)
        s->lam[e] -= change[STAGES * n_q + e];
    for (int i = 0; i < STAGES; i++) {
        for (Size e = 0; e < n_q; e++) {
            A[e] = 0;
            for (int j = 0; j < STAGES; j++)
                A[e] += s->tableau->squared[i][j] * change[j * n_q + e];
        }
        of_a += squared_size<T>(n_q, A, p->weights);
        memcpy(s->room->B, s->B + i * p->constraints->n_values,
               (size_t)p->constraints->n_values * sizeof(T));
        reaction_of<T>(p, s->room, change + STAGES * n_q + i * n_lam, s->room->force);
        of_lam += squared_size<T>(n_q, s->room->force, p->inverse);
    }
    return sqrt(of_a + of_lam);
}

/* Newton's method; `size` is that of the last correction, relative to the motion. */
template <class T> int stages_iterated(StageStep<T> *s)
{
    const StageRules *rules = s->rules;
    double usual = motion_before_stages<T>(s), last = INFINITY, motion = INFINITY;
    double floor = rules->positions * DBL_EPSILON * size_of<T>(s->plan->n_q, s->q, s->plan->weights);
    double most = usual > DBL_MIN ? rules->most * usual : INFINITY;
    int known = 0, strained = 0, settled = 0;
    floor /= rules->h * rules->h;
    s->size = INFINITY;
    while (s->iterations < rules->max_iterations + LAG<T>) {
        double now = stage_residuals<T>(s);
        s->iterations++;
        if (!isfinite(now))
            return STAGES_NOT_FINITE;
        motion = fmin(motion, fmin(most, now));
        int fresh = !known || strained;
        if (fresh && stages_singular<T>(s))
            return STAGES_SINGULAR;
        strained = fresh ? now > rules->jump * usual : strained;
        double change = stages_changed<T>(s);
        /* Nothing acts at the start or in the guess: the correction is the motion. */
        if (last == INFINITY && fmax(usual, now) < DBL_EPSILON * change) {
            motion = usual = change;
            most = rules->most * usual;
        }
        double size = s->size = change / motion;
        if (!isfinite(size))
            return STAGES_DIVERGED;
        double rate = last < INFINITY ? fmin(size / last, 1) : size > 0;
        int stuck =
            last < INFINITY && rate > rules->slow && size <= rules->round_off + floor / motion;
        double left = size * (fresh ? rate * rate : fmin(rate / (1.001 - rate), 1));
        if (settled || stuck || left <= rules->tolerance) {
            if (settled++ == 0)
                s->stuck = stuck;
            if (settled > LAG<T>)
                return STAGES_SOLVED;
            /* The matrix of the solution serves the imaginary part. (With the last one accelerations
             * of complex steps err three times as much, at tolerances of 1e-10 and more.) */
            known = settled > 1;
        } else
            known = last == INFINITY || size * pow(rate, rules->more) <= rules->tolerance;
        last = size;
    }
    return STAGES_DIVERGED;
}
