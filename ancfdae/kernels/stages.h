/* Steps of Radau IIA with three stages, known or under error control (control.h), for one scalar type.
 *
 * `integrators/radau/stages.py` states the equations of a step and has the rules of Newton's method,
 * `step.py` there states the completion of stages and the error of a step. Matrices are real.
 */

enum { STAGES = 3 };

/* Places c, A^-1, A^-2, A, weights of the embedded formula and the real eigenvalue of A^-1. */
struct StageTableau {
    double c[STAGES], inverse[STAGES][STAGES], squared[STAGES][STAGES], butcher[STAGES][STAGES];
    double embedded[STAGES], gamma;
};

/* Size of the step and the rules of `stages.py`. */
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

/* Coefficients of joints at an instant, of which 3 is the start of the step, with their time derivatives
 * up to an order. */
template <class T> void stage_instant(const StageStep<T> *s, int i, int order, T *work, const T **c)
{
    const Plan<T> *p = s->plan;
    c[0] = p->own ? s->of_joints + i : p->numbers.part_0;
    for (int k = 1; k <= order; k++)
        c[k] = nullptr;
    if (!p->still && !p->own)
        coefficients<T>(p->constraints, &p->numbers, order, i, STAGES + 1, s->of_joints, work, c);
}

template <class T> void stage_instant(const StageStep<T> *s, int i)
{
    stage_instant<T>(s, i, 0, s->room->at_end, s->room->c);
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
        constraint_at<T>(p, r, 0, r->c, r->q, nullptr, Phi);
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

/* How far the forces of all stages are from balance, and may be where they balance each other. */
template <class T> double stages_unbalanced(const StageStep<T> *s)
{
    double sum = 0;
    for (int i = 0; i < STAGES; i++)
        sum += squared_size<T>(s->plan->n_q, s->R + i * s->plan->n_q, s->plan->inverse);
    return sqrt(sum);
}

template <class T> double stages_at_rest(const StageStep<T> *s)
{
    const T *of_loads = s->of_loads + (STAGES - 1) * s->plan->n_factors;
    return sqrt((double)STAGES) * at_rest<T>(s->plan, s->room, of_loads, s->rules->tolerance);
}

/* Newton's method: 0, or how steps end. `size` is the last correction relative to the motion. */
template <class T> int stages_iterated(StageStep<T> *s)
{
    const StageRules *rules = s->rules;
    double usual = motion_before_stages<T>(s), last = INFINITY, motion = INFINITY;
    double floor = rules->positions * DBL_EPSILON * size_of<T>(s->plan->n_q, s->q, s->plan->weights);
    double most = usual > DBL_MIN ? rules->most * usual : INFINITY;
    int known = 0, strained = 0, settled = 0;
    floor /= rules->h * rules->h;
    s->size = INFINITY;
    while ((double)s->iterations < rules->max_iterations + LAG<T>) {
        double now = stage_residuals<T>(s);
        s->iterations++;
        if (!isfinite(now))
            return RESIDUAL_NOT_FINITE;
        motion = fmin(motion, fmin(most, now));
        int fresh = !known || strained;
        if (fresh && stages_singular<T>(s))
            return MATRIX_SINGULAR;
        strained = fresh ? now > rules->jump * usual : strained;
        double change = stages_changed<T>(s);
        /* Nothing acts at the start or in the guess: the correction is the motion. */
        if (last == INFINITY && fmax(usual, now) < DBL_EPSILON * change) {
            motion = usual = change;
            most = rules->most * usual;
        }
        double size = s->size = change / motion;
        if (!isfinite(size))
            return NO_CONVERGENCE;
        double rate = last < INFINITY ? fmin(size / last, 1) : size > 0;
        int stuck =
            last < INFINITY && rate > rules->slow && size <= rules->round_off + floor / motion;
        if (!stuck && s->iterations > USUAL && lost<T>(s->plan, s->q, change * rules->h * rules->h))
            stuck = stages_unbalanced<T>(s) <= stages_at_rest<T>(s);
        double left = size * (fresh ? rate * rate : fmin(rate / (1.001 - rate), 1));
        if (settled || stuck || left <= rules->tolerance) {
            if (settled++ == 0)
                s->stuck = stuck;
            if (settled > LAG<T>)
                return 0;
            /* The matrix of the solution serves the imaginary part. (With the last one accelerations
             * of complex steps err three times as much, at tolerances of 1e-10 and more.) */
            known = settled > 1;
        } else
            known = last == INFINITY || size * pow(rate, rules->more) <= rules->tolerance;
        last = size;
    }
    return NO_CONVERGENCE;
}

/* M and Phi_q by themselves. */
const StepCoefficients OF_MASS_ALONE = {0, 0, 0, 0, 0, 0, 1};

/* Factorise M and Phi_q as they stand in the room: 0, or as `factor_sum`. */
int mass_factorised(const Plan<double> *p, Room<double> *r)
{
    r->exchanging = 0;
    memset(r->f_q, 0, (size_t)p->nnz * sizeof(double));
    if (p->velocity)
        memset(r->f_v, 0, (size_t)p->nnz * sizeof(double));
    return factor_sum(p, r, &OF_MASS_ALONE, r->f_q, nullptr, r->B);
}

/* x = [M Phi_q^T; Phi_q 0]^-1 right, or its transpose, for rows. */
int mass_solved(const Plan<double> *p, Room<double> *r, char how, Size rows, const double *right,
                double *x)
{
    return solved_rows(p, r, &OF_MASS_ALONE, how, TO_ROUND_OFF, rows, right, x);
}

/* Steps of Radau IIA: the tolerances of positions and velocities, if there are any; rows (q, v, a, lam)
 * of the start and the stages of the step before, of which there are 4 or 1, and of all stages after it;
 * and room: `known` is whether the factors of M and Phi_q, with values in `factored`, still stand. */
template <class T> struct StageRun final : StepRun {
    StageStep<T> step;
    StageRules rules;
    StepLaws<T> *laws;
    bool controlled, known;
    StepTolerance tolerances[2];
    const double *place, *scale;
    Size n_before, continued, counts[3];
    const T *before[4];
    T *rows[4];
    double *instants, *factored, *reals;
    StepTables<T> tables;

    int tried(double h, double end, double *e) override;
};

/* Row i of the start and the stages of the step before step k. */
template <class T> const T *row_before(const StageRun<T> *c, int what, Size k, int i)
{
    Size at = STAGES * (k - 1) - 1 + i, size = what < 3 ? c->step.plan->n_q : c->step.plan->n_lam;
    return at >= 0 ? c->rows[what] + at * size : c->before[what] + (c->n_before + at) * size;
}

/* Newton's method from the guess as it stands, for a step of size h to `end`. */
template <class T> int stages_solved_for(StageRun<T> *c, double h, double end)
{
    StageStep<T> *s = &c->step;
    if (!c->laws->at(c->t, end, h, &c->tables))
        return LAW_RAISED;
    s->of_joints = c->tables.of_joints, s->of_loads = c->tables.of_loads;
    c->rules.h = h, s->iterations = s->factorisations = s->stuck = 0;
    int ends = stages_iterated<T>(s);
    c->counts[0] += s->iterations, c->counts[1] += s->factorisations, c->counts[2] += s->stuck;
    return ends;
}

/* The guess of x for a step of size h, from velocities at the start and the stages of a step before,
 * whose cubic is extrapolated to times `ahead` in units of that step. */
template <class T>
void stages_ahead(StageStep<T> *s, double h, const T *const rows[4], const double ahead[STAGES])
{
    const StageTableau *of = s->tableau;
    double at[4] = {0, of->c[0], of->c[1], of->c[2]}, share[STAGES][4];
    for (int i = 0; i < STAGES; i++)
        for (int k = 0; k < 4; k++) {
            share[i][k] = 1;
            for (int j = 0; j < 4; j++)
                share[i][k] *= j == k ? 1 : (ahead[i] - at[j]) / (at[k] - at[j]);
        }
    for (Size e = 0; e < s->plan->n_q; e++) {
        T rise[STAGES];
        for (int i = 0; i < STAGES; i++) {
            rise[i] = -1.0 * s->v[e];
            for (int k = 0; k < 4; k++)
                rise[i] += share[i][k] * rows[k][e];
        }
        for (int i = 0; i < STAGES; i++) {
            T sum = 0;
            for (int j = 0; j < STAGES; j++)
                sum += of->butcher[i][j] * rise[j];
            s->x[i * s->plan->n_q + e] = sum / h;
        }
    }
}

/* The guess that accelerations and multipliers stay. */
template <class T> void stages_still(StageStep<T> *s)
{
    Size n_q = s->plan->n_q, n_lam = s->plan->n_lam;
    for (int i = 0; i < STAGES; i++) {
        double share = s->tableau->c[i] * s->tableau->c[i] / 2;
        for (Size e = 0; e < n_q; e++)
            s->x[i * n_q + e] = share * s->a[e];
        memcpy(s->lam + i * n_lam, s->lam_before, (size_t)n_lam * sizeof(T));
    }
}

/* Shortest part of a step by way of which it is solved. */
#define SHORTEST_PART 1e-3

/* Solve for the stages by way of shorter steps from the same start, each a quarter of the one before
 * until one is solved, then of twice the size each. */
template <class T> int stages_continued(StageRun<T> *c, double h, double end, int ends)
{
    StageStep<T> *s = &c->step;
    Size n_q = s->plan->n_q;
    double part = 1, twice[STAGES];
    auto go = [&] { return stages_solved_for(c, part * h, part == 1 ? end : c->t + part * h); };
    auto failed = [&] { return ends == NO_CONVERGENCE || ends == RESIDUAL_NOT_FINITE; };
    while (failed() && part > SHORTEST_PART) {
        part /= 4;
        stages_still<T>(s);
        ends = go();
    }
    c->continued += ends == 0;
    for (int i = 0; i < STAGES; i++)
        twice[i] = 2 * s->tableau->c[i];
    while (ends == 0 && part < 1) {
        T *V = s->R;
        for (int i = 0; i < STAGES; i++) {
            stage_state<T>(s, i);
            memcpy(V + i * n_q, s->room->v, (size_t)n_q * sizeof(T));
        }
        const T *rows[4] = {s->v, V, V + n_q, V + 2 * n_q};
        part *= 2;
        stages_ahead<T>(s, part * h, rows, twice);
        ends = go();
    }
    return ends;
}

/* Factorise M and Phi_q as they stand at stage i, unless they are the last ones: 0, or as `factor_sum`. */
template <class T> int stage_mass_known(StageRun<T> *c, int i)
{
    const Plan<T> *of = c->step.plan;
    auto [p, r, loads] = real_state(of, c->step.room, c->step.of_loads + i * of->n_factors);
    Size n_B = p->constraints->n_values, n_M = p->own ? p->nnz : 0;
    double *M = c->factored + n_B;
    if (p->own && PARTS<T> > 1)
        mass_at<double>(p, r, r->q);
    auto same = [](Size n, const double *x, const double *y) { return std::equal(x, x + n, y); };
    if (c->known && same(n_B, r->B, c->factored) && same(n_M, p->K.values, M)) {
        memset(r->f_q, 0, (size_t)p->nnz * sizeof(double)); /* for a factorisation with exchanges */
        return 0;
    }
    int failed = mass_factorised(p, r);
    c->known = !failed, c->counts[1]++;
    std::copy(r->B, r->B + n_B, c->factored);
    std::copy(p->K.values, p->K.values + n_M, M);
    return failed;
}

/* x = [M Phi_q^T; Phi_q 0]^-1 (force, side) with M and Phi_q as they stand. The factors are real: the
 * imaginary part of complex matrices is corrected for. */
template <class T>
int mass_corrected(const Plan<T> *p, Room<T> *r, const T *force, const T *side, T *x)
{
    const Plan<double> *real = real_plan(p);
    Room<double> *in_real = real_room(p, r);
    Size n_q = p->n_q, n = n_q + p->n_lam;
    double *right = in_real->columns, *found = right + 2 * n;
    std::fill(x, x + n, T(0));
    for (int times = 0; times <= LAG<T>; times++) {
        std::copy(force, force + n_q, r->R);
        std::copy(side, side + p->n_lam, r->R + n_q);
        if (times) {
            csr_alone<T>(n_q, p->M.first, p->M.columns, p->M.values, x, -1, r->R);
            csr_rows_transposed<T>(p->n_lam, p->B.first, p->B.columns, r->B, 1, x + n_q, -1, n_q,
                                   r->R);
            csr_alone<T>(p->n_lam, p->B.first, p->B.columns, r->B, x, -1, r->R + n_q);
        }
        parted<T>(n, r->R, right);
        int failed = mass_solved(real, in_real, 'N', PARTS<T>, right, found);
        if (failed)
            return failed;
        for (Size e = 0; e < n; e++)
            x[e] += joined(found + e, n, T(0));
    }
    return 0;
}

/* Complete stage i: remove from v what violates the constraints, and find a and lam. */
template <class T> int stage_finished(StageRun<T> *c, int i, const T *q, T *v, T *a, T *lam)
{
    StageStep<T> *s = &c->step;
    const Plan<T> *p = s->plan;
    Room<T> *r = s->room;
    Size n_q = p->n_q, n_lam = p->n_lam;
    const T *of_time[3];
    stage_instant<T>(s, i, 2, r->within, of_time);
    r->c[0] = of_time[0];
    memcpy(r->q, q, (size_t)n_q * sizeof(T));
    jacobian_at<T>(p, r, of_time, q);
    mass_at<T>(p, r, q);
    constraint_at<T>(p, r, 1, of_time, q, v, r->Phi);
    int failed = stage_mass_known(c, i);
    if (failed || (failed = mass_corrected<T>(p, r, r->still, r->Phi, r->x)))
        return failed;
    for (Size e = 0; e < n_q; e++)
        v[e] -= r->x[e];
    force_at<T>(p, r, s->of_loads + i * p->n_factors, q, v);
    constraint_at<T>(p, r, 2, of_time, q, v, r->Phi);
    for (Size e = 0; e < n_lam; e++)
        r->Phi[e] = -1.0 * r->Phi[e];
    if ((failed = mass_corrected<T>(p, r, r->Q, r->Phi, r->x)))
        return failed;
    memcpy(a, r->x, (size_t)n_q * sizeof(T));
    memcpy(lam, r->x + n_q, (size_t)n_lam * sizeof(T));
    return 0;
}

/* Coefficients of the matrix of the embedded formula. */
StepCoefficients of_embedded(const StageTableau *of, double h)
{
    return {h, 0, 0, 0, h * h, of->gamma * h, of->gamma * of->gamma};
}

/* dq and dv, the errors of a step by the embedded formula, from velocities at the start and the stages,
 * the acceleration at the start, and x of the stages. Matrices stand in the room as `factorised` leaves
 * them: 0, or as `factor_sum`. */
int embedded_error(const Plan<double> *p, Room<double> *r, const StageTableau *of, double h,
                   const double *const v[STAGES + 1], const double *a, const double *const x[STAGES],
                   double *dq, double *dv)
{
    Size n_q = p->n_q, n_lam = p->n_lam;
    double k = of->gamma / h, *right = r->columns, *found = right + n_q + n_lam;
    double *r_q = r->v_p, *r_v = r->ahead;
    double *of_q = r->q_p, *of_v = r->dq_p; /* what joints prescribe, across the free directions */
    StepCoefficients coefficients = of_embedded(of, h);
    auto solved = [&] {
        return solved_rows(p, r, &coefficients, 'N', TO_ROUND_OFF, 1, right, found);
    };
    for (Size e = 0; e < n_q; e++) {
        double sum = 0, turned = 0, rise = 0;
        for (int i = 0; i < STAGES; i++) {
            sum += of->embedded[i] * x[i][e];
            rise += of->embedded[i] * ((v[i + 1][e] - v[0][e]) / h);
            for (int j = 0; j < STAGES; j++)
                turned += of->embedded[j] * of->inverse[j][i] * x[i][e];
        }
        dq[e] = of_q[e] = h * sum, dv[e] = a[e] + turned, of_v[e] = a[e] + rise;
    }
    for (int times = 0; times < 2; times++) {
        double share = times ? k : 1;
        for (Size e = 0; e < n_q; e++)
            r_q[e] = share * dq[e], r_v[e] = h * h * (share * dv[e] + k * r_q[e]);
        memset(right, 0, (size_t)(n_q + n_lam) * sizeof(double));
        csr_times<double>(&p->M, r_v, right);
        if (p->velocity)
            csr_alone<double>(n_q, p->K.first, p->K.columns, r->f_v, r_q, h * h, right);
        int failed = solved();
        if (failed)
            return failed;
        for (Size e = 0; e < n_q; e++)
            dq[e] = found[e], dv[e] = k * found[e] - r_q[e];
    }
    for (double *to : {dq, dv}) {
        memset(right, 0, (size_t)(n_q + n_lam) * sizeof(double));
        csr_alone<double>(n_lam, p->B.first, p->B.columns, r->B, to == dq ? of_q : of_v, 1 / k,
                          right + n_q);
        int failed = solved();
        if (failed)
            return failed;
        for (Size e = 0; e < n_q; e++)
            to[e] += found[e];
    }
    return 0;
}

/* e of a step that stands behind those taken: of its positions, velocities and rotations. */
template <class T> int stages_judged(StageRun<T> *c, double h, double *error)
{
    StageStep<T> *s = &c->step;
    Room<T> *r = s->room;
    const int middle = 1;
    Size n_q = s->plan->n_q, n_lam = s->plan->n_lam, k = c->taken, at = STAGES * k + middle;
    memcpy(r->q, c->rows[0] + at * n_q, (size_t)n_q * sizeof(T));
    memcpy(r->v, c->rows[1] + at * n_q, (size_t)n_q * sizeof(T));
    memcpy(r->A, c->rows[2] + at * n_q, (size_t)n_q * sizeof(T));
    memcpy(r->lam, c->rows[3] + at * n_lam, (size_t)n_lam * sizeof(T));
    stage_instant<T>(s, middle);
    jacobian_at<T>(s->plan, r, r->c, r->q);
    auto [p, in_real, loads] = real_state(s->plan, r, s->of_loads + middle * s->plan->n_factors);
    StepCoefficients of = of_embedded(s->tableau, h);
    c->known = false, c->counts[1]++, in_real->exchanging = 0;
    int failed = factorised(p, in_real, &of, loads);
    double *rows = c->reals, *delta[2] = {rows + 8 * n_q, rows + 9 * n_q};
    const T *V = c->rows[1] + at * n_q, *x_of = s->x;
    const T *from[8] = {s->v, V - n_q, V, V + n_q, s->a, x_of, x_of + n_q, x_of + 2 * n_q};
    const double *x[8];
    for (int i = 0; i < 8; i++) {
        for (Size e = 0; e < n_q; e++)
            rows[i * n_q + e] = real_part(from[i][e]);
        x[i] = rows + i * n_q;
    }
    if (!failed)
        failed = embedded_error(p, in_real, s->tableau, h, x, x[4], x + 5, delta[0], delta[1]);
    if (failed)
        return failed;
    *error = c->tables.turn;
    const T *old[2] = {s->q, s->v}, *end = c->rows[0] + (at + 1) * n_q;
    for (int i = 0; i < 2; i++) {
        /* x has the round-off of positions over h^2. */
        double round_off = i ? DBL_EPSILON / h : DBL_EPSILON;
        double found = error_against(
            c->tolerances[i], old[i], c->rows[i] + (at + 1) * n_q, i ? nullptr : c->place,
            [&](Size e) { return delta[i][e]; },
            [&](Size e) { return round_off * (fabs(real_part(end[e])) + c->scale[e]); });
        *error = larger_error(*error, found);
    }
    return 0;
}

template <class T> int StageRun<T>::tried(double h, double end, double *e)
{
    StageStep<T> *s = &step;
    Size n_q = s->plan->n_q, n_lam = s->plan->n_lam, k = taken;
    Size before_this[4] = {counts[0], counts[1], counts[2], continued};
    s->q = row_before(this, 0, k, STAGES), s->v = row_before(this, 1, k, STAGES);
    s->a = row_before(this, 2, k, STAGES), s->lam_before = row_before(this, 3, k, STAGES);
    stages_still<T>(s);
    if (k || n_before > 1) {
        const T *v[4];
        double ahead[STAGES];
        for (int i = 0; i <= STAGES; i++)
            v[i] = row_before(this, 1, k, i);
        for (int i = 0; i < STAGES; i++)
            ahead[i] = 1 + h / last * s->tableau->c[i];
        stages_ahead<T>(s, h, v, ahead);
    }
    int ends = stages_solved_for(this, h, end);
    /* Under error control a smaller step is the better remedy. */
    if (ends && !controlled)
        ends = stages_continued(this, h, end, ends);
    for (int i = 0; i < STAGES && !ends; i++) {
        Size at = STAGES * k + i;
        T *q = rows[0] + at * n_q, *v = rows[1] + at * n_q;
        stage_state<T>(s, i);
        memcpy(q, s->room->q, (size_t)n_q * sizeof(T));
        memcpy(v, s->room->v, (size_t)n_q * sizeof(T));
        instants[at] = i < STAGES - 1 ? t + h * s->tableau->c[i] : end;
        ends = stage_finished(this, i, q, v, rows[2] + at * n_q, rows[3] + at * n_lam);
    }
    if (!ends && controlled)
        ends = stages_judged(this, h, e);
    /* What a step alone costs counts even where it is not solved. */
    if (ends && (ends < NO_CONVERGENCE || (!filter && most > 1)))
        std::copy(before_this, before_this + 3, counts), continued = before_this[3];
    if (ends == MATRIX_SINGULAR)
        s->size = 0;
    return ends;
}
