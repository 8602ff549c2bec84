/* Steps of HHT-I3 with Newton's method (docs/theory/05-hht-i3.md), for one scalar type.
 *
 * The formulas, and what stops an iteration, are those of `integrators/hht`: `newton.py` says why.
 * A step that is not solved here is left to them, which find out what is wrong with it, so that
 * nothing has to be told but how many steps were taken.
 */

/* Settings of Newton's method in steps of HHT-I3, numbers only (`integrators/hht/newton.py`), with
 * the places and weights of the Gauss points of small steps. */
struct MarchRules {
    double alpha, tolerance, max_iterations, blur, slow, near, ahead, smooth, round_off, jump,
        quiet;
    double places[3], weights[3];
};

/* Step size, and Newmark coefficients with what a adds to q, v and A. */
struct StepCoefficients {
    double h, alpha, beta, gamma, in_q, in_v, in_A;
};

StepCoefficients coefficients_of_step(double h, double alpha)
{
    double beta = (1 - alpha) * (1 - alpha) / 4, gamma = (1 - 2 * alpha) / 2;
    StepCoefficients c = {h, alpha, beta, gamma, beta * (h * h), gamma * h, 1 / (1 + alpha)};
    return c;
}

double seconds_now()
{
    std::chrono::duration<double> now = std::chrono::steady_clock::now().time_since_epoch();
    return now.count();
}

/* A matrix in compressed sparse rows. */
template <class T> struct Csr {
    Size n;
    const int32_t *first, *columns;
    const T *values;
};

/* out += M x. */
template <class T> INLINE void csr_times(const Csr<T> *m, const T *x, T *out)
{
    csr_alone<T>(m->n, m->first, m->columns, m->values, x, 1, out);
}

/* Rows of a table of factors, one table for each step: at its end, at its beginning, at the Gauss
 * points of small steps, and the time derivatives there. */
enum { AT_END, AT_START, AT_GAUSS, RATE_AT_GAUSS = AT_GAUSS + 3, ALL_INSTANTS = RATE_AT_GAUSS + 3 };
/* How a march ends: with all steps, or before one that is not solved, that needs factors at Gauss
 * points, whose matrix is indefinite, or that no time is left for. */
enum { ALL_TAKEN, NOT_SOLVED, NEEDS_GAUSS, INDEFINITE, OUT_OF_TIME };

/* Corrections from a guess close to the solution shrink by this factor at least (`_CLOSE`). */
#define CLOSE 0.5

/* A load that moves, whether it uses velocities, and its first factor in a row. */
template <class T> struct MovingLoad {
    const LoadTable *plan;
    LoadNumbers<T> numbers;
    int velocity;
    Size factor;
};

/* A system of lists of operations in place of elements, joints and loads. All lists take t, q, v, A,
 * lam and b: Phi_q, Phi, dPhi/dt, Q, M, and f_q with f_v behind it where forces use velocities. */
enum { OF_JACOBIAN, OF_PLACE, OF_RATE, OF_FORCE, OF_MASS, OF_TANGENTS, MARCH_LISTS };

template <class T> struct Listed {
    const Operations *of[MARCH_LISTS];
    const T *constants[MARCH_LISTS], *b;
    Size n_b;
};

/* A system with its matrices and the settings of Newton's method. `first` is nullptr without an
 * envelope, `Fronts` without these, `flat` without a band; `chosen`, `places` and `signs` belong to
 * the envelope or to the fronts. Factors are those of all loads, `velocity` tells whether forces
 * depend on it; coefficients of joints that are `still` are the same at all
 * instants. */
template <class T> struct Plan {
    Size n_q, n_lam, nnz, n_loads, n_moving, n_factors, n_chosen, half;
    int n_y, d, damped, velocity, still;
    Block<T> block;
    const ConstraintTable *constraints;
    const MovingLoad<T> *moving;
    ConstraintNumbers<T> numbers;
    Csr<T> M, K, B; /* K has the values of M on the pattern of all tangents */
    const int32_t *index, *first, *chosen, *places;
    const int64_t *order, *flat;
    const Fronts *fronts;
    const Listed<T> *listed; /* nullptr for a scene; its factors are the times */
    const T *gravity, *loads;
    const double *weights, *inverse, *signs, *scale, *factors;
    Gbtrf<T> gbtrf;
    Gbtrs<T> gbtrs;
    MarchRules rules;
};

/* Room for what an iteration writes. `ahead` holds dq of a small step; coefficients c belong to the
 * end of the step, those in `within` to instants in it, U to vectors of one joint. */
enum { BY_ENVELOPE, BY_BAND, BY_FRONTS };

template <class T> struct Room {
    T *q_p, *dq_p, *v_p, *q, *v, *A, *a, *lam, *U, *B, *Q, *inner, *reaction, *ahead, *start;
    T *Phi, *rate, *defect, *R, *x, *force, *f_q, *f_v, *sum, *matrix, *work;
    T *at_end, *within, *of_load, *numbers, *mass;
    const T *c[1];
    double *least, of_B;
    FrontRoom in_fronts;
    int *pivots, B_known, factored; /* How: by an envelope, by a band or by fronts. */
    Size counts[3];                 /* iterations, factorisations, steps that round-off disturbs */
};

/* The state before a step. */
template <class T> struct Before {
    const T *q, *v, *a, *lam, *A;
    double motion;
};

template <class T> INLINE double size_of(Size n, const T *x, const double *weights)
{
    double sum = 0;
    for (Size i = 0; i < n; i++)
        sum += weights[i] * real_part(x[i]) * real_part(x[i]);
    return sqrt(sum);
}

/* Outputs of a list at a state, of which it reads what is given. */
template <class T>
void listed_at(const Plan<T> *p, Room<T> *r, int which, T t, const T *q, const T *v, const T *A,
               const T *lam, T *out, Size count)
{
    const Listed<T> *s = p->listed;
    const Operations *of = s->of[which];
    const T *parts[] = {&t, q, v, A, lam, s->b, s->constants[which]};
    Size sizes[] = {1, p->n_q, p->n_q, p->n_q, p->n_lam, s->n_b, of->n_constants};
    T *to = r->numbers;
    for (int i = 0; i < 7; to += sizes[i++])
        if (parts[i])
            memcpy(to, parts[i], (size_t)sizes[i] * sizeof(T));
    list_evaluated<T>(of, 1, r->numbers);
    for (Size i = 0; i < count; i++)
        out[i] = r->numbers[of->outputs[i]];
}

/* M, which moves in a system of lists. */
template <class T> void mass_at(const Plan<T> *p, Room<T> *r, const T *q)
{
    if (p->listed)
        listed_at<T>(p, r, OF_MASS, 0, q, nullptr, nullptr, nullptr, r->mass, p->nnz);
}

/* Phi_q on its pattern. */
template <class T> void jacobian_at(const Plan<T> *p, Room<T> *r, const T *const *c, const T *q)
{
    const T *X[] = {q};
    if (p->listed) {
        listed_at<T>(p, r, OF_JACOBIAN, *c[0], q, nullptr, nullptr, nullptr, r->B,
                     p->constraints->n_values);
        return;
    }
    if (r->B_known)
        return;
    memset(r->B, 0, (size_t)p->constraints->n_values * sizeof(T));
    constraints<T>(p->constraints, p->numbers.l, VALUES, 0, c, X, nullptr, r->U, r->B);
    r->B_known = p->still && p->constraints->n_s == 0;
}

/* Phi, or its first time derivative along v. */
template <class T>
void constraint_at(const Plan<T> *p, Room<T> *r, const T *const *c, const T *q, const T *v, T *Phi)
{
    const T *X[] = {q, v};
    if (p->listed) {
        listed_at<T>(p, r, v ? OF_RATE : OF_PLACE, *c[0], q, v, nullptr, nullptr, Phi, p->n_lam);
        return;
    }
    memset(Phi, 0, (size_t)p->n_lam * sizeof(T));
    constraints<T>(p->constraints, p->numbers.l, RATE, v ? 1 : 0, c, X, nullptr, r->U, Phi);
}

/* Coefficients from a row of factors, and their rates from the third row on where asked for. */
template <class T>
void at_instant(const Plan<T> *p, Room<T> *r, const double *factors, int instant, int rates,
                const T **c)
{
    c[0] = p->listed ? factors + instant : p->numbers.part_0;
    c[rates] = rates ? nullptr : c[0];
    if (p->listed)
        return;
    if (!p->still)
        coefficients<T>(p->constraints, &p->numbers, rates, 0, RATE_AT_GAUSS - AT_GAUSS,
                        factors + instant * p->constraints->n_parts, r->within, c);
}

/* out = Phi_q^T lam with the Jacobian as it stands. */
template <class T> void reaction_of(const Plan<T> *p, const Room<T> *r, const T *lam, T *out)
{
    memset(out, 0, (size_t)p->n_q * sizeof(T));
    csr_rows_transposed<T>(p->n_lam, p->B.first, p->B.columns, r->B, 1, lam, 1, p->n_q, out);
}

template <class T>
void force_at(const Plan<T> *p, Room<T> *r, const double *factors, const T *q, const T *v)
{
    if (p->listed) {
        listed_at<T>(p, r, OF_FORCE, factors[0], q, v, nullptr, nullptr, r->Q, p->n_q);
        return;
    }
    memset(r->inner, 0, (size_t)p->n_q * sizeof(T));
    forces<T>(p->n_y, p->d, &p->block, q, p->damped ? v : nullptr, r->inner);
    for (Size i = 0; i < p->n_q; i++)
        r->Q[i] = p->gravity[i] - r->inner[i];
    for (Size k = 0; k < p->n_loads; k++)
        for (Size i = 0; i < p->n_q; i++)
            r->Q[i] += factors[k] * p->loads[k * p->n_q + i];
    for (Size k = 0; k < p->n_moving; k++)
        load_force<T>(p->moving[k].plan, &p->moving[k].numbers, factors + p->moving[k].factor, q,
                      v, r->of_load, r->Q);
}

/* Phi = defect + its integral over a small step along dq. */
template <class T>
void constraint_over(const Plan<T> *p, Room<T> *r, double h, const double *factors, const T *q,
                     const T *dq, T *Phi)
{
    const T *c[2];
    memcpy(Phi, r->defect, (size_t)p->n_lam * sizeof(T));
    for (int k = 0; k < 3; k++) {
        for (Size i = 0; i < p->n_q; i++) {
            r->x[i] = q[i] + p->rules.places[k] * dq[i];
            r->force[i] = dq[i] / h;
        }
        at_instant<T>(p, r, factors, AT_GAUSS + k, 1, c);
        constraint_at<T>(p, r, c, r->x, r->force, r->rate);
        for (Size i = 0; i < p->n_lam; i++)
            Phi[i] += p->rules.weights[k] * h * r->rate[i];
    }
}

template <class T> double motion_of(const Plan<T> *p, const Room<T> *r, const T *a)
{
    double size = size_of<T>(p->n_q, a, p->weights) + size_of<T>(p->n_q, r->reaction, p->inverse) +
                  size_of<T>(p->n_q, r->Q, p->inverse);
    double least = fmax(p->rules.blur, DBL_MIN);
    return size < least ? least : size; /* also what is not a number */
}

template <class T>
double motion_before(const Plan<T> *p, Room<T> *r, const Before<T> *b, const double *of_joints,
                     const double *of_loads)
{
    if (b->motion < INFINITY)
        return b->motion;
    const T *c[1];
    at_instant<T>(p, r, of_joints, AT_START, 0, c);
    jacobian_at<T>(p, r, c, b->q);
    reaction_of<T>(p, r, b->lam, r->reaction);
    force_at<T>(p, r, of_loads + AT_START * p->n_factors, b->q, b->v);
    return motion_of<T>(p, r, b->a);
}

/* Coordinates, velocities and accelerations that belong to a (eqs. 2, 3). */
template <class T>
void state_of(const Plan<T> *p, const Room<T> *r, const StepCoefficients *c, const T *A_n,
              const T *a, T *q, T *v, T *A)
{
    for (Size i = 0; i < p->n_q; i++) {
        q[i] = r->q_p[i] + c->in_q * a[i];
        v[i] = r->v_p[i] + c->in_v * a[i];
        A[i] = (c->alpha * c->in_A) * A_n[i] + c->in_A * a[i];
    }
}

template <class T>
void predict(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const Before<T> *b)
{
    double of_a = c->h * (1 - c->gamma), of_dq = c->h * c->h * (c->gamma - 0.5 - c->beta);
    for (Size i = 0; i < p->n_q; i++) {
        r->v_p[i] = b->v[i] + of_a * b->a[i];
        r->dq_p[i] = c->h * r->v_p[i] + of_dq * b->a[i];
        r->q_p[i] = b->q[i] + r->dq_p[i];
    }
}

/* The guess of a: a step ahead where the line through a and A is smooth. */
template <class T> void look_ahead(const Plan<T> *p, Room<T> *r, const Before<T> *b, double motion)
{
    double times = p->rules.alpha ? fmin(-1 / p->rules.alpha, p->rules.ahead) : 0;
    for (Size i = 0; i < p->n_q; i++)
        r->a[i] = b->A[i] - b->a[i];
    if (times * size_of<T>(p->n_q, r->a, p->weights) > p->rules.smooth * motion)
        times = 0;
    for (Size i = 0; i < p->n_q; i++)
        r->a[i] = b->a[i] + times * r->a[i];
    memcpy(r->lam, b->lam, (size_t)p->n_lam * sizeof(T));
}

/* The residual of eqs. (4) and (5) at a and lam; whether it is finite. */
template <class T>
int residual_at(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const Before<T> *b,
                const double *of_joints, const double *of_loads, int small)
{
    T sum = 0, *R = r->R;
    state_of<T>(p, r, c, b->A, r->a, r->q, r->v, r->A);
    if (small) {
        for (Size i = 0; i < p->n_q; i++)
            r->ahead[i] = r->dq_p[i] + c->in_q * r->a[i];
        constraint_over<T>(p, r, c->h, of_joints, b->q, r->ahead, r->Phi);
    }
    if (!small)
        constraint_at<T>(p, r, r->c, r->q, nullptr, r->Phi);
    jacobian_at<T>(p, r, r->c, r->q);
    reaction_of<T>(p, r, r->lam, r->reaction);
    force_at<T>(p, r, of_loads + AT_END * p->n_factors, r->q, r->v);
    memset(R, 0, (size_t)p->n_q * sizeof(T));
    mass_at<T>(p, r, r->q);
    csr_times<T>(&p->M, r->A, R);
    for (Size i = 0; i < p->n_q; i++) {
        R[i] += r->reaction[i] - r->Q[i];
        sum += 0 * R[i];
    }
    for (Size i = 0; i < p->n_lam; i++) {
        R[p->n_q + i] = (1 / c->in_q) * r->Phi[i];
        sum += 0 * R[p->n_q + i];
    }
    return sum == 0;
}

/* Factorise eq. (6) in a band, from values as below: 0 or NOT_SOLVED. */
template <class T>
int banded_sum(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const T *f_q, const T *f_v,
               const T *B)
{
    Size n = p->n_q + p->n_lam, n_B = p->constraints->n_values;
    for (Size i = 0; i < p->nnz; i++)
        r->sum[i] = c->in_A * p->K.values[i] + c->in_q * f_q[i];
    for (Size i = 0; f_v && i < p->nnz; i++)
        r->sum[i] += c->in_v * f_v[i];
    r->factored = BY_BAND;
    memset(r->matrix, 0, (size_t)n * (3 * (size_t)p->half + 1) * sizeof(T));
    return band_factor<T>(p->gbtrf, (int)n, (int)p->half, p->nnz, n_B, r->sum, B, p->factors,
                          p->flat, r->matrix, r->pivots, &r->of_B)
               ? NOT_SOLVED
               : 0;
}

/* Factorise eq. (6) by fronts, from values as below: 0 or NOT_SOLVED. */
template <class T>
int sum_in_fronts(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const T *f_q, const T *B)
{
    FrontRoom *x = &r->in_fronts;
    memset(x->a, 0, (size_t)p->fronts->column_at[p->fronts->n] * sizeof *x->a);
    ldl_placed<T>(p->n_chosen, p->chosen, p->places, c->in_A, p->K.values, x->a);
    ldl_placed<T>(p->n_chosen, p->chosen, p->places, c->in_q, f_q, x->a);
    ldl_placed<T>(p->constraints->n_values, nullptr, p->places + p->n_chosen, 1, B, x->a);
    r->factored = BY_FRONTS;
    return fronts_factored(p->fronts, x, r->matrix) ? NOT_SOLVED : 0;
}

/* Factorise eq. (6) from values of f_q, f_v, nullptr where there is none, and Phi_q: 0, NOT_SOLVED, or
 * INDEFINITE. */
template <class T>
int factor_sum(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const T *f_q, const T *f_v,
               const T *B)
{
    Size n = p->n_q + p->n_lam, n_B = p->constraints->n_values;
    if (p->first && !f_v) {
        memset(r->matrix, 0, (size_t)p->first[n] * sizeof(T));
        ldl_placed<T>(p->n_chosen, p->chosen, p->places, c->in_A, p->K.values, r->matrix);
        ldl_placed<T>(p->n_chosen, p->chosen, p->places, c->in_q, f_q, r->matrix);
        ldl_placed<T>(n_B, nullptr, p->places + p->n_chosen, 1, B, r->matrix);
        if (ldl_factor<T>(n, p->first, p->signs, r->matrix, r->least) == 0)
            return r->factored = BY_ENVELOPE;
    }
    if (p->fronts)
        return f_v ? NOT_SOLVED : sum_in_fronts<T>(p, r, c, f_q, B);
    return p->flat ? banded_sum<T>(p, r, c, f_q, f_v, B) : INDEFINITE;
}

/* Subtract Q_q, or Q_v, of loads that move. */
template <class T>
void load_tangents(const Plan<T> *p, Room<T> *r, const double *factors, int velocity, T *values)
{
    for (Size k = 0; k < p->n_moving; k++)
        if (!velocity || p->moving[k].velocity)
            load_tangent<T>(p->moving[k].plan, &p->moving[k].numbers, -1,
                            factors + p->moving[k].factor, r->q, r->v, velocity, r->of_load,
                            values);
}

/* Values of f_q and f_v at the state as it stands, from a row of factors of loads. */
template <class T> void linearised(const Plan<T> *p, Room<T> *r, const double *factors)
{
    const T *v = p->damped ? r->v : nullptr;
    if (p->listed) {
        /* f_v stands behind f_q. */
        listed_at<T>(p, r, OF_TANGENTS, factors[0], r->q, r->v, r->A, r->lam, r->f_q,
                     p->velocity ? 2 * p->nnz : p->nnz);
        mass_at<T>(p, r, r->q);
        return;
    }
    memset(r->f_q, 0, (size_t)p->nnz * sizeof(T));
    tangents<T>(p->n_y, p->d, &p->block, r->q, v, 0, p->index, p->nnz, r->f_q);
    constraint_curvature<T>(p->constraints, p->numbers.l, r->c[0], r->lam, r->f_q);
    load_tangents<T>(p, r, factors, 0, r->f_q);
    if (!p->velocity)
        return;
    memset(r->f_v, 0, (size_t)p->nnz * sizeof(T));
    if (p->damped)
        tangents<T>(p->n_y, p->d, &p->block, r->q, nullptr, 1, p->index, p->nnz, r->f_v);
    load_tangents<T>(p, r, factors, 1, r->f_v);
}

/* Factorise eq. (6) at the state as it stands. */
template <class T>
int factorised(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const double *of_loads)
{
    r->counts[1]++;
    linearised<T>(p, r, of_loads + AT_END * p->n_factors);
    return factor_sum<T>(p, r, c, r->f_q, p->velocity ? r->f_v : nullptr, r->B);
}

/* Scale of an unknown of the band. */
template <class T> INLINE double band_scale(const Plan<T> *p, const Room<T> *r, int64_t i)
{
    return i < p->n_q ? p->scale[i] : r->of_B * p->scale[i];
}

/* x = J^-1 right, or its transpose, for rows, by fronts with a residual `enough`: 0, or NOT_SOLVED
 * where refinement does not converge. */
template <class T>
int solve_rows(const Plan<T> *p, Room<T> *r, char how, double enough, Size rows, const T *right,
               T *x)
{
    Size n = p->n_q + p->n_lam;
    if (r->factored == BY_FRONTS)
        return fronts_solve(enough, p->fronts, r->in_fronts.a, r->matrix, p->order,
                            r->in_fronts.scale, rows, 1, right, r->work,
                            x) <= fmax(enough, UNREFINED)
                   ? 0
                   : NOT_SOLVED;
    if (r->factored == BY_ENVELOPE) {
        ldl_solve<T>(n, p->first, r->matrix, p->order, rows, 1, right, r->work, x);
        return 0;
    }
    for (; rows > 0; rows--, right += n, x += n) {
        for (Size i = 0; i < n; i++)
            r->work[i] = band_scale<T>(p, r, p->order[i]) * right[p->order[i]];
        band_solve<T>(p->gbtrs, how, (int)n, (int)p->half, 1, r->matrix, r->pivots, r->work);
        for (Size i = 0; i < n; i++)
            x[p->order[i]] = band_scale<T>(p, r, p->order[i]) * r->work[i];
    }
    return 0;
}

/* Whether round-off of elastic forces leaves less than seven digits of the motion. */
template <class T> int blurred(const Plan<T> *p, Room<T> *r)
{
    if (size_of<T>(p->n_q, r->a, p->weights) >= p->rules.blur)
        return 0;
    reaction_of<T>(p, r, r->lam, r->force);
    return size_of<T>(p->n_q, r->force, p->inverse) < p->rules.blur;
}

/* The residual at the guess a, or where that is far from balance at the state before the step, as
 * `_from_rest` in `newton.py`; `close` tells whether corrections must shrink quickly then. */
template <class T>
int residual_at_guess(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const Before<T> *b,
                      const double *of_joints, const double *of_loads, int small, double motion,
                      int *close)
{
    int finite = residual_at<T>(p, r, c, b, of_joints, of_loads, small);
    double unbalanced = size_of<T>(p->n_q, r->R, p->inverse);
    *close = !(unbalanced <= p->rules.jump * motion);
    if (!*close)
        return finite;
    for (Size i = 0; i < p->n_q; i++)
        r->a[i] = -r->dq_p[i] / c->in_q;
    finite = residual_at<T>(p, r, c, b, of_joints, of_loads, small);
    *close = !(size_of<T>(p->n_q, r->R, p->inverse) > p->rules.smooth * unbalanced);
    if (*close)
        return finite;
    look_ahead<T>(p, r, b, motion);
    return residual_at<T>(p, r, c, b, of_joints, of_loads, small);
}

/* Newton's method for one step; the solution stands in a and lam. */
template <class T>
int iterated(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const Before<T> *b,
             const double *of_joints, const double *of_loads, int small, double motion_before,
             double *motion_after)
{
    double last = INFINITY;
    double motion = motion_before > DBL_MIN ? p->rules.jump * motion_before : INFINITY;
    int fresh = 1, close = 0;
    for (Size i = 0; i < p->rules.max_iterations; i++) {
        r->counts[0]++;
        if (!(i ? residual_at<T>(p, r, c, b, of_joints, of_loads, small)
                : residual_at_guess<T>(p, r, c, b, of_joints, of_loads, small, motion_before,
                                       &close)))
            return NOT_SOLVED;
        int failed = fresh ? factorised<T>(p, r, c, of_loads) : 0;
        if (failed || (failed = solve_rows<T>(p, r, 'N', ENOUGH, 1, r->R, r->x)))
            return failed;
        for (Size k = 0; k < p->n_q; k++)
            r->a[k] -= r->x[k];
        for (Size k = 0; k < p->n_lam; k++)
            r->lam[k] -= r->x[p->n_q + k];
        double now = motion_of<T>(p, r, r->a);
        motion = now < motion ? now : motion;
        reaction_of<T>(p, r, r->x + p->n_q, r->force);
        double size =
            (size_of<T>(p->n_q, r->x, p->weights) + size_of<T>(p->n_q, r->force, p->inverse)) /
            motion;
        double rate = last > 0 && last < INFINITY ? fmin(size / last, 1) : size > 0;
        if (close && last < INFINITY && size > p->rules.round_off && rate > CLOSE)
            return NOT_SOLVED;
        int stuck = fresh && rate > 0.5 && size <= p->rules.round_off &&
                    size_of<T>(p->n_q, r->R, p->inverse) <= p->rules.round_off * now;
        double left = size * (fresh ? fmin(1, rate * rate) : rate / fmax(1 - rate, 1e-3));
        if (stuck || left <= p->rules.tolerance || size <= p->rules.tolerance) {
            r->counts[2] += stuck || blurred<T>(p, r);
            *motion_after = now;
            return 0;
        }
        if (last < INFINITY)
            fresh = rate > p->rules.slow ||
                    (size < p->rules.near && size * (rate * rate * rate) > p->rules.tolerance);
        else
            fresh = size > p->rules.slow;
        last = size;
    }
    return NOT_SOLVED;
}

/* One step from b; of the state after it a stays in the room. */
template <class T>
int stepped(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const Before<T> *b,
            const double *of_joints, Size instants, const double *of_loads, double *motion_after)
{
    double motion = motion_before<T>(p, r, b, of_joints, of_loads);
    double noise = DBL_EPSILON * size_of<T>(p->n_q, b->q, p->weights);
    double allowed = p->rules.quiet * motion * c->in_q;
    int small = p->n_lam && !(noise <= allowed);
    if (small && instants < ALL_INSTANTS)
        return NEEDS_GAUSS;
    predict<T>(p, r, c, b);
    look_ahead<T>(p, r, b, motion);
    if (small) {
        const T *at_start[1];
        at_instant<T>(p, r, of_joints, AT_START, 0, at_start);
        constraint_at<T>(p, r, at_start, b->q, nullptr, r->defect);
        for (Size i = 0; i < p->n_lam; i++)
            r->defect[i] *= allowed / noise;
    }
    r->c[0] = p->listed ? of_joints + AT_END : p->numbers.part_0;
    if (!p->still && !p->listed)
        coefficients<T>(p->constraints, &p->numbers, 0, 0, 1,
                        of_joints + AT_END * p->constraints->n_parts, r->at_end, r->c);
    return iterated<T>(p, r, c, b, of_joints, of_loads, small, motion, motion_after);
}

/* As many of k steps of sizes h as can be taken until the clock says so; the states after them are
 * rows of q, v, A and lam. Tables of factors have `instants` rows of joints, two of loads, or are
 * empty. `ends` tells why no more are taken; what stands in b belongs to the last state then. */
template <class T>
Size marched(const Plan<T> *p, Room<T> *r, Before<T> *b, Size k, const double *h, Size instants,
             const double *of_joints, const double *of_loads, double until, T *const out[4], T *a,
             int *ends)
{
    Size sizes[] = {p->n_q, p->n_q, p->n_q, p->n_lam}, n_q = p->n_q;
    for (Size n = 0; n < k; n++) {
        StepCoefficients c = coefficients_of_step(h[n], p->rules.alpha);
        Size counts[3];
        double motion = 0, ratio = n ? h[n] / h[n - 1] : 1;
        if (n && seconds_now() > until)
            return *ends = OUT_OF_TIME, n;
        Before<T> begin = *b;
        if (ratio != 1) {
            for (Size i = 0; i < n_q; i++)
                r->start[i] = b->A[i] + ratio * (b->a[i] - b->A[i]);
            begin.a = r->start;
        }
        memcpy(counts, r->counts, sizeof counts);
        *ends = stepped<T>(p, r, &c, &begin, of_joints + n * instants * p->constraints->n_parts,
                           instants, of_loads + n * 2 * p->n_factors, &motion);
        if (*ends) {
            memcpy(r->counts, counts, sizeof counts);
            return n;
        }
        T *row[4];
        for (int i = 0; i < 4; i++)
            row[i] = out[i] + n * sizes[i];
        state_of<T>(p, r, &c, b->A, r->a, row[0], row[1], row[2]);
        memcpy(row[3], r->lam, (size_t)p->n_lam * sizeof(T));
        memcpy(a, r->a, (size_t)n_q * sizeof(T));
        Before<T> after = {row[0], row[1], a, row[3], row[2], motion};
        *b = after;
    }
    *ends = ALL_TAKEN;
    return k;
}
