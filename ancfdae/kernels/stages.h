/* Newton's method for the three stages of a step of Radau IIA, in real numbers.
 *
 * The equations, and what stops an iteration, are those of `integrators/radau`: `stages.py` and
 * `newton.py` say what they are. Plans are those of marches (prepared.h).
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

/* A step: where it begins, what is solved for, and room. R and `change` have the coordinates of all
 * stages, then their multipliers. */
struct StageStep {
    const Plan<double> *plan;
    Room<double> *room;
    const StageTableau *tableau;
    const StageRules *rules;
    const double *q, *v, *a, *lam_before, *of_joints, *of_loads, *scale, *factors;
    const int64_t *order, *flat, *places;
    Gbtrf<double> gbtrf;
    Gbtrs<double> gbtrs;
    Size half, size_K, iterations, factorisations, stuck;
    double *x, *lam, *R, *change, *B, *K, *band, *work;
    int *pivots;
    double size, of_B;
};

/* Position, velocity and acceleration of stage i, and coefficients of joints, in the room. */
void stage_state(const StageStep *s, int i)
{
    const Plan<double> *p = s->plan;
    Room<double> *r = s->room;
    double h = s->rules->h;
    for (Size e = 0; e < p->n_q; e++) {
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
void stage_instant(const StageStep *s, int i)
{
    const Plan<double> *p = s->plan;
    s->room->c[0] = p->listed ? s->of_joints + i : p->numbers.part_0;
    if (!p->still && !p->listed)
        coefficients<double>(p->constraints, &p->numbers, 0, 0, 1,
                             s->of_joints + i * p->constraints->n_parts, s->room->at_end,
                             s->room->c);
}

double squared_size(Size n, const double *x, const double *weights)
{
    double size = size_of<double>(n, x, weights);
    return size * size;
}

/* Sizes of accelerations, reactions and forces of all stages together. */
double motion_of_stages(const StageStep *s, const double sums[3])
{
    return fmax(sqrt(sums[0]) + sqrt(sums[1]) + sqrt(sums[2]), s->rules->least);
}

/* Size of the motion at three stages like the start. */
double motion_before_stages(const StageStep *s)
{
    const Plan<double> *p = s->plan;
    Room<double> *r = s->room;
    stage_instant(s, STAGES);
    jacobian_at<double>(p, r, r->c, s->q);
    reaction_of<double>(p, r, s->lam_before, r->reaction);
    force_at<double>(p, r, s->of_loads + STAGES * p->n_factors, s->q, s->v);
    const double sums[] = {STAGES * squared_size(p->n_q, s->a, p->weights),
                           STAGES * squared_size(p->n_q, r->reaction, p->inverse),
                           STAGES * squared_size(p->n_q, r->Q, p->inverse)};
    return motion_of_stages(s, sums);
}

/* Residuals of all stages and Phi_q there; returns the size of the motion, NaN where one is. */
double stage_residuals(StageStep *s)
{
    const Plan<double> *p = s->plan;
    Room<double> *r = s->room;
    Size n_q = p->n_q, n_lam = p->n_lam, n_B = p->constraints->n_values;
    double sums[3] = {0, 0, 0}, all = 0, h = s->rules->h;
    for (int i = 0; i < STAGES; i++) {
        double *R = s->R + i * n_q, *Phi = s->R + STAGES * n_q + i * n_lam;
        stage_state(s, i);
        stage_instant(s, i);
        constraint_at<double>(p, r, r->c, r->q, nullptr, Phi);
        jacobian_at<double>(p, r, r->c, r->q);
        memcpy(s->B + i * n_B, r->B, (size_t)n_B * sizeof(double));
        reaction_of<double>(p, r, r->lam, r->reaction);
        force_at<double>(p, r, s->of_loads + i * p->n_factors, r->q, r->v);
        memset(R, 0, (size_t)n_q * sizeof(double));
        mass_at<double>(p, r, r->q);
        csr_times<double>(&p->M, r->A, R);
        for (Size e = 0; e < n_q; e++) {
            R[e] += r->reaction[e] - r->Q[e];
            all += 0 * R[e];
        }
        for (Size e = 0; e < n_lam; e++) {
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
int stages_factorised(StageStep *s)
{
    const Plan<double> *p = s->plan;
    Room<double> *r = s->room;
    const int64_t *place = s->places;
    double h = s->rules->h;
    int n = STAGES * (int)(p->n_q + p->n_lam), half = (int)s->half;
    s->factorisations++;
    for (int i = 0; i < STAGES; i++) {
        stage_state(s, i);
        stage_instant(s, i);
        linearised<double>(p, r, s->of_loads + i * p->n_factors);
        for (int j = 0; j < STAGES; j++) {
            double of_M = s->tableau->squared[i][j], of_v = h * s->tableau->inverse[i][j];
            double of_q = i == j ? h * h : 0;
            for (Size e = 0; e < p->nnz; e++)
                s->K[*place++] =
                    of_M * p->K.values[e] + of_q * r->f_q[e] + (p->velocity ? of_v * r->f_v[e] : 0);
        }
    }
    memset(s->band, 0, (size_t)n * (3 * (size_t)half + 1) * sizeof(double));
    return band_factor<double>(s->gbtrf, n, half, s->size_K, STAGES * p->constraints->n_values,
                               s->K, s->B, s->factors, s->flat, s->band, s->pivots, &s->of_B);
}

/* Scale of an unknown of the band. */
double stage_scale(const StageStep *s, int64_t i)
{
    return i < STAGES * s->plan->n_q ? s->scale[i] : s->of_B * s->scale[i];
}

/* Solve for the change of x and lam, and apply it; returns its size in units of force. */
double stages_changed(StageStep *s)
{
    const Plan<double> *p = s->plan;
    Size n_q = p->n_q, n_lam = p->n_lam, n = STAGES * (n_q + n_lam);
    double of_a = 0, of_lam = 0, *A = s->room->A, *change = s->change;
    for (Size e = 0; e < n; e++)
        s->work[e] = stage_scale(s, s->order[e]) * s->R[s->order[e]];
    band_solve<double>(s->gbtrs, 'N', (int)n, (int)s->half, 1, s->band, s->pivots, s->work);
    for (Size e = 0; e < n; e++)
        change[s->order[e]] = stage_scale(s, s->order[e]) * s->work[e];
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
        of_a += squared_size(n_q, A, p->weights);
        memcpy(s->room->B, s->B + i * p->constraints->n_values,
               (size_t)p->constraints->n_values * sizeof(double));
        reaction_of<double>(p, s->room, change + STAGES * n_q + i * n_lam, s->room->force);
        of_lam += squared_size(n_q, s->room->force, p->inverse);
    }
    return sqrt(of_a + of_lam);
}

/* Newton's method; `size` is that of the last correction, relative to the motion. */
int stages_iterated(StageStep *s)
{
    const StageRules *rules = s->rules;
    double usual = motion_before_stages(s), last = INFINITY, motion = INFINITY;
    double floor =
        rules->positions * DBL_EPSILON * size_of<double>(s->plan->n_q, s->q, s->plan->weights);
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
        double change = stages_changed(s);
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
        if (stuck || left <= rules->tolerance) {
            s->stuck = stuck;
            return STAGES_SOLVED;
        }
        known = last == INFINITY || size * pow(rate, rules->more) <= rules->tolerance;
        last = size;
    }
    return STAGES_DIVERGED;
}
