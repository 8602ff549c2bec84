/* Steps of HHT-I3 with Newton's method (docs/theory/05-hht-i3.md), for one scalar type.
 *
 * States and residuals have the scalar. Matrices are real and belong to the real part of a state: an
 * imaginary part is solved for as another column.
 */

/* Settings of Newton's method in steps of HHT-I3 (`integrators/hht/step.py` has their values and
 * reasons), with the places and weights of the Gauss points of small steps. */
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
/* Corrections from a guess close to the solution shrink by this factor at least. */
#define CLOSE 0.5
/* Iterations after the real part has settled: one for the imaginary part, and one for its round-off. */
template <class T> constexpr int LAG = std::is_same<T, double>::value ? 0 : 2;

/* A load that moves, whether it uses velocities, and its first factor in a row. */
template <class T> struct MovingLoad {
    const LoadTable *plan;
    LoadNumbers<T> numbers;
    int velocity;
    Size factor;
};

/* Matrices that are factorised outside of the core. */
struct MatrixSolver {
    virtual ~MatrixSolver() = default;
    /* Whether a sum of numbers times values, with B, is singular. */
    virtual bool fails(int terms, const double *numbers, const double *const *values,
                       const double *B) = 0;
    /* Rows of solutions for rows of right sides. */
    virtual void solve(bool transposed, Size rows, const double *right, double *x) = 0;
};

template <class T> struct Room;

/* A system with its matrices and the settings of Newton's method. `first` is nullptr without an
 * envelope, `Fronts` without these, `flat` without a band, and so is `solver`; `chosen`, `places`
 * and `signs` belong to the envelope or to the fronts. Factors are those of all loads, `velocity`
 * tells whether forces depend on it; coefficients of joints that are `still` are the same at all
 * instants. A system at complex numbers has its matrices in a plan of their real parts. */
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
    Equations<T> *own; /* nullptr for a scene; else factors are the times */
    MatrixSolver *solver;
    const T *gravity, *loads;
    const double *weights, *inverse, *signs, *scale, *factors;
    Gbtrf<double> gbtrf;
    Gbtrs<double> gbtrs;
    MarchRules rules;
    const Plan<double> *real;
    Room<double> *real_room;
};

/* Room for what an iteration writes. `ahead` holds dq of a small step; coefficients c belong to the
 * end of the step, those in `within` to instants in it, U to vectors of one joint. */
enum { BY_ENVELOPE, BY_BAND, BY_FRONTS, BY_SOLVER };

template <class T> struct Room {
    T *q_p, *dq_p, *v_p, *q, *v, *A, *a, *lam, *U, *B, *Q, *inner, *reaction, *ahead, *start;
    T *Phi, *rate, *defect, *R, *x, *force, *f_q, *f_v, *sum, *matrix, *work;
    T *at_end, *within, *of_load, *mass, *turned, *still; /* `still` holds zeros */
    const T *c[1];
    double *least, *time_factors, *columns, of_B;
    FrontRoom in_fronts;
    int *pivots, B_known, factored; /* How: by an envelope, a band, fronts or a solver. */
    int exchanging;                 /* Whether fronts have failed in this step. */
    Size counts[3];                 /* iterations, factorisations, steps that round-off disturbs */
};

/* How a step is to be solved: from a guess, or from one made here where a is nullptr; corrections
 * shrink by the factor `allowed` at least. */
template <class T> struct Attempt {
    const T *a, *lam;
    double tolerance, allowed, iterations;
};

/* What is told of an attempt: the size of the motion, of the last correction relative to it, and
 * the slowest rate at which corrections above round-off shrank. */
struct Ending {
    double motion, size, slowest;
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

/* M, which moves in a system of one's own. */
template <class T> void mass_at(const Plan<T> *p, Room<T> *r, const T *q)
{
    if (p->own)
        p->own->mass(q, r->mass);
}

/* Phi_q on its pattern. */
template <class T> void jacobian_at(const Plan<T> *p, Room<T> *r, const T *const *c, const T *q)
{
    const T *X[] = {q};
    if (p->own)
        return p->own->jacobian(*c[0], q, r->B);
    if (r->B_known)
        return;
    memset(r->B, 0, (size_t)p->constraints->n_values * sizeof(T));
    constraints<T>(p->constraints, p->numbers.l, VALUES, 0, c, X, nullptr, r->U, r->B);
    r->B_known = p->still && p->constraints->n_s + p->constraints->n_formulas == 0;
}

/* Phi, or its time derivative of an order along v, the second one without accelerations. */
template <class T>
void constraint_at(const Plan<T> *p, Room<T> *r, int order, const T *const *c, const T *q,
                   const T *v, T *Phi)
{
    const T *X[] = {q, v, r->still};
    if (p->own)
        return p->own->constraint(*c[0], order, q, v, Phi);
    memset(Phi, 0, (size_t)p->n_lam * sizeof(T));
    constraints<T>(p->constraints, p->numbers.l, RATE, order, c, X, nullptr, r->U, Phi);
}

/* Coefficients from a row of factors, and their rates from the third row on where asked for. */
template <class T>
void at_instant(const Plan<T> *p, Room<T> *r, const T *factors, int instant, int rates,
                const T **c)
{
    c[0] = p->own ? factors + instant : p->numbers.part_0;
    c[rates] = rates ? nullptr : c[0];
    if (p->own)
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

/* Q from elastic forces -`inner`, gravity and loads. */
template <class T>
void applied_at(const Plan<T> *p, Room<T> *r, const T *factors, const T *q, const T *v,
                const T *inner)
{
    for (Size i = 0; i < p->n_q; i++)
        r->Q[i] = p->gravity[i] - inner[i];
    for (Size k = 0; k < p->n_loads; k++)
        for (Size i = 0; i < p->n_q; i++)
            r->Q[i] += factors[k] * p->loads[k * p->n_q + i];
    for (Size k = 0; k < p->n_moving; k++)
        load_force<T>(p->moving[k].plan, &p->moving[k].numbers, factors + p->moving[k].factor, q,
                      v, r->of_load, r->Q);
}

template <class T>
void force_at(const Plan<T> *p, Room<T> *r, const T *factors, const T *q, const T *v)
{
    if (p->own)
        return p->own->force(factors[0], q, v, r->Q);
    memset(r->inner, 0, (size_t)p->n_q * sizeof(T));
    forces<T>(p->n_y, p->d, &p->block, q, p->damped ? v : nullptr, r->inner);
    applied_at<T>(p, r, factors, q, v, r->inner);
}

/* Phi = defect + its integral over a small step along dq. */
template <class T>
void constraint_over(const Plan<T> *p, Room<T> *r, double h, const T *factors, const T *q,
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
        constraint_at<T>(p, r, 1, c, r->x, r->force, r->rate);
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
double motion_before(const Plan<T> *p, Room<T> *r, const Before<T> *b, const T *of_joints,
                     const T *of_loads)
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
                const T *of_joints, const T *of_loads, int small)
{
    T sum = 0, *R = r->R;
    state_of<T>(p, r, c, b->A, r->a, r->q, r->v, r->A);
    if (small) {
        for (Size i = 0; i < p->n_q; i++)
            r->ahead[i] = r->dq_p[i] + c->in_q * r->a[i];
        constraint_over<T>(p, r, c->h, of_joints, b->q, r->ahead, r->Phi);
    }
    if (!small)
        constraint_at<T>(p, r, 0, r->c, r->q, nullptr, r->Phi);
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

/* Factorise eq. (6) in a band, from values as below: whether it is singular. */
int banded_sum(const Plan<double> *p, Room<double> *r, const StepCoefficients *c,
               const double *f_q, const double *f_v, const double *B)
{
    Size n = p->n_q + p->n_lam, n_B = p->constraints->n_values;
    for (Size i = 0; i < p->nnz; i++)
        r->sum[i] = c->in_A * p->K.values[i] + c->in_q * f_q[i];
    for (Size i = 0; f_v && i < p->nnz; i++)
        r->sum[i] += c->in_v * f_v[i];
    r->factored = BY_BAND;
    memset(r->matrix, 0, (size_t)n * (3 * (size_t)p->half + 1) * sizeof(double));
    return band_factor<double>(p->gbtrf, (int)n, (int)p->half, p->nnz, n_B, r->sum, B, p->factors,
                               p->flat, r->matrix, r->pivots, &r->of_B) != 0;
}

/* Write the lower triangle of eq. (6) without f_v to places of an envelope or of fronts. */
void placed_sum(const Plan<double> *p, const StepCoefficients *c, const double *f_q,
                const double *B, double *to)
{
    const int32_t *__restrict chosen = p->chosen, *__restrict places = p->places;
    for (Size i = 0; i < p->n_chosen; i++)
        to[places[i]] = c->in_A * p->K.values[chosen[i]] + c->in_q * f_q[chosen[i]];
    ldl_placed<double>(p->constraints->n_values, nullptr, p->places + p->n_chosen, 1, B, to);
}

/* Factorise eq. (6) as below, but not in an envelope. */
int factor_sum_out_of_envelope(const Plan<double> *p, Room<double> *r, const StepCoefficients *c,
                               const double *f_q, const double *f_v, const double *B)
{
    Size n = p->n_q + p->n_lam;
    if (p->fronts && !f_v && !r->exchanging) {
        memset(r->in_fronts.a, 0, (size_t)p->fronts->column_at[n] * sizeof(double));
        placed_sum(p, c, f_q, B, r->in_fronts.a);
        r->factored = BY_FRONTS;
        if (!fronts_factored(p->fronts, &r->in_fronts, r->matrix))
            return 0;
    }
    r->factored = BY_SOLVER;
    if (p->solver) {
        const double numbers[] = {c->in_A, c->in_q, c->in_v};
        const double *const values[] = {p->K.values, f_q, f_v};
        return p->solver->fails(f_v ? 3 : 2, numbers, values, B) ? MATRIX_SINGULAR : 0;
    }
    if (!p->flat)
        return INDEFINITE;
    return banded_sum(p, r, c, f_q, f_v, B) ? MATRIX_SINGULAR : 0;
}

/* Factorise eq. (6) from values of f_q, f_v, nullptr where there is none, and Phi_q: 0, INDEFINITE
 * or MATRIX_SINGULAR. */
int factor_sum(const Plan<double> *p, Room<double> *r, const StepCoefficients *c,
               const double *f_q, const double *f_v, const double *B)
{
    Size n = p->n_q + p->n_lam;
    if (p->first && !f_v) {
        memset(r->matrix, 0, (size_t)p->first[n] * sizeof(double));
        placed_sum(p, c, f_q, B, r->matrix);
        if (ldl_factor<double>(n, p->first, p->signs, r->matrix, r->least) == 0)
            return r->factored = BY_ENVELOPE;
    }
    return factor_sum_out_of_envelope(p, r, c, f_q, f_v, B);
}

/* Subtract Q_q, or Q_v, of loads that move. */
void load_tangents(const Plan<double> *p, Room<double> *r, const double *factors, int velocity,
                   double *values)
{
    for (Size k = 0; k < p->n_moving; k++)
        if (!velocity || p->moving[k].velocity)
            load_tangent<double>(p->moving[k].plan, &p->moving[k].numbers, -1,
                            factors + p->moving[k].factor, r->q, r->v, velocity, r->of_load,
                            values);
}

/* Add (Phi_q^T lam)_q of a scene at the state as it stands to f_q. */
void curvature_at(const Plan<double> *p, Room<double> *r)
{
    const double *X[] = {r->q};
    constraint_curvature<double>(p->constraints, p->numbers.l, 0, r->c, X, r->lam, r->U, r->f_q);
}

/* Values of f_q and f_v at the state as it stands, from a row of factors of loads. */
void linearised(const Plan<double> *p, Room<double> *r, const double *factors)
{
    const double *v = p->damped ? r->v : nullptr;
    if (p->own) {
        p->own->tangents(factors[0], r->q, r->v, r->A, r->lam, r->f_q, r->f_v);
        return mass_at<double>(p, r, r->q);
    }
    memset(r->f_q, 0, (size_t)p->nnz * sizeof(double));
    tangents<double>(p->n_y, p->d, &p->block, r->q, v, 0, p->index, p->nnz, r->f_q);
    curvature_at(p, r);
    load_tangents(p, r, factors, 0, r->f_q);
    if (!p->velocity)
        return;
    memset(r->f_v, 0, (size_t)p->nnz * sizeof(double));
    if (p->damped)
        tangents<double>(p->n_y, p->d, &p->block, r->q, nullptr, 1, p->index, p->nnz, r->f_v);
    load_tangents(p, r, factors, 1, r->f_v);
}

/* Factorise eq. (6) at the state as it stands, from a row of factors of loads. */
int factorised(const Plan<double> *p, Room<double> *r, const StepCoefficients *c,
               const double *of_loads)
{
    linearised(p, r, of_loads);
    return factor_sum(p, r, c, r->f_q, p->velocity ? r->f_v : nullptr, r->B);
}

/* Scale of an unknown of the band. */
INLINE double band_scale(const Plan<double> *p, const Room<double> *r, int64_t i)
{
    return i < p->n_q ? p->scale[i] : r->of_B * p->scale[i];
}

/* x = J^-1 right, or its transpose, for rows, by fronts with a residual `enough`: whether refinement
 * does not converge there. */
int solve_rows(const Plan<double> *p, Room<double> *r, char how, double enough, Size rows,
               const double *right, double *x)
{
    Size n = p->n_q + p->n_lam;
    if (r->factored == BY_FRONTS)
        return fronts_solve(enough, p->fronts, r->in_fronts.a, r->matrix, p->order,
                            r->in_fronts.scale, rows, 1, right, r->work,
                            x) > fmax(enough, UNREFINED);
    if (r->factored == BY_SOLVER)
        p->solver->solve(how == 'T', rows, right, x);
    if (r->factored == BY_ENVELOPE)
        ldl_solve<double>(n, p->first, r->matrix, p->order, rows, 1, right, r->work, x);
    for (; r->factored == BY_BAND && rows > 0; rows--, right += n, x += n) {
        for (Size i = 0; i < n; i++)
            r->work[i] = band_scale(p, r, p->order[i]) * right[p->order[i]];
        band_solve<double>(p->gbtrs, how, (int)n, (int)p->half, 1, r->matrix, r->pivots, r->work);
        for (Size i = 0; i < n; i++)
            x[p->order[i]] = band_scale(p, r, p->order[i]) * r->work[i];
    }
    return 0;
}

/* The same; where fronts do not refine a solution the matrix of the values as they stand is
 * factorised with exchanges: 0, or as `factor_sum`. */
int solved_rows(const Plan<double> *p, Room<double> *r, const StepCoefficients *c, char how,
                double enough, Size rows, const double *right, double *x)
{
    if (!solve_rows(p, r, how, enough, rows, right, x))
        return 0;
    r->exchanging = 1;
    int failed = factor_sum(p, r, c, r->f_q, p->velocity ? r->f_v : nullptr, r->B);
    if (!failed)
        solve_rows(p, r, how, enough, rows, right, x);
    return failed;
}

/* The real part of a state as it stands, with the plan and the row of factors of loads for it. */
struct RealState {
    const Plan<double> *plan;
    Room<double> *room;
    const double *of_loads;
};

RealState real_state(const Plan<double> *p, Room<double> *r, const double *of_loads)
{
    return {p, r, of_loads};
}

RealState real_state(const Plan<Complex> *p, const Room<Complex> *from, const Complex *of_loads)
{
    Room<double> *r = p->real_room;
    const std::tuple<Size, const Complex *, double *> all[] = {
        {p->n_q, from->q, r->q},
        {p->n_q, from->v, r->v},
        {p->n_q, from->A, r->A},
        {p->n_lam, from->lam, r->lam},
        {p->constraints->n_values, from->B, r->B},
        {p->constraints->n_c, from->c[0], r->at_end},
        {p->n_factors, of_loads, r->time_factors}};
    for (auto &[size, x, to] : all)
        for (Size i = 0; x && i < size; i++)
            to[i] = x[i].re;
    r->c[0] = from->c[0] ? r->at_end : nullptr;
    return {p->real, r, r->time_factors};
}

const Plan<double> *real_plan(const Plan<double> *p) { return p; }
const Plan<double> *real_plan(const Plan<Complex> *p) { return p->real; }
Room<double> *real_room(const Plan<double> *, Room<double> *r) { return r; }
Room<double> *real_room(const Plan<Complex> *p, Room<Complex> *) { return p->real_room; }

/* Rows of the parts of a number: its real part, and its imaginary one if it has any. */
template <class T> constexpr Size PARTS = sizeof(T) / sizeof(double);

template <class T> void parted(Size n, const T *x, double *to)
{
    for (Size part = 0; part < PARTS<T>; part++)
        for (Size i = 0; i < n; i++)
            to[part * n + i] = part ? imaginary_part(x[i]) : real_part(x[i]);
}

double joined(const double *x, Size, double) { return *x; }
Complex joined(const double *x, Size n, Complex) { return {x[0], x[n]}; }

/* r->x = J^-1 r->R, with J at the real part of the state as it stands where it is to be `fresh`:
 * 0, or as `factor_sum`. */
template <class T>
int corrected(const Plan<T> *of, Room<T> *from, const StepCoefficients *c, const T *of_loads,
              int fresh, double enough)
{
    auto [p, r, loads] = real_state(of, from, of_loads);
    Size n = p->n_q + p->n_lam;
    double *right = r->columns, *x = right + 2 * n;
    from->counts[1] += fresh;
    int failed = fresh ? factorised(p, r, c, loads) : 0;
    parted<T>(n, from->R, right);
    if (!failed)
        failed = solved_rows(p, r, c, 'N', enough, PARTS<T>, right, x);
    for (Size i = 0; i < n; i++)
        from->x[i] = joined(x + i, n, T(0));
    return failed;
}

/* Whether round-off of elastic forces leaves less than seven digits of the motion. */
template <class T> int blurred(const Plan<T> *p, Room<T> *r)
{
    if (size_of<T>(p->n_q, r->a, p->weights) >= p->rules.blur)
        return 0;
    reaction_of<T>(p, r, r->lam, r->force);
    return size_of<T>(p->n_q, r->force, p->inverse) < p->rules.blur;
}

/* How far forces are from balance. */
template <class T> double unbalanced(const Plan<T> *p, const Room<T> *r)
{
    return size_of<T>(p->n_q, r->R, p->inverse);
}

/* Errors in the last place of coordinates that a force adds up. */
constexpr double ROUNDINGS = 8;
/* Iterations of a step after which the forces at rest are looked at. */
constexpr Size USUAL = 3;

/* Whether a correction of coordinates is lost in their last place. */
template <class T> bool lost(const Plan<T> *p, const T *q, double correction)
{
    return correction <= ROUNDINGS * DBL_EPSILON * size_of<T>(p->n_q, q, p->weights);
}

/* What may remain of R where forces balance each other, as on a body at rest on a spring: the
 * tolerance times the forces that act, each counted by itself, and the round-off that f_q makes of
 * errors in the last place of coordinates. Elastic forces have a round-off of their own (`blur`).
 * Corrections may shrink steadily there without an end: those of q are lost in its last place. */
template <class T>
double at_rest(const Plan<T> *of, Room<T> *from, const T *of_loads, double tolerance)
{
    auto [p, r, factors] = real_state(of, from, of_loads);
    int known = p->own || p->n_moving; /* whether some f_q is not elastic */
    std::vector<double> left((size_t)p->n_q), values(p->own || !known ? 0 : (size_t)p->nnz);
    if (p->own)
        p->own->force(factors[0], r->q, r->v, left.data());
    else
        left.assign(p->gravity, p->gravity + p->n_q);
    for (double &each : left)
        each = fabs(each);
    for (Size k = 0; k < p->n_loads; k++)
        for (Size i = 0; i < p->n_q; i++)
            left[i] += fabs(factors[k] * p->loads[k * p->n_q + i]);
    for (Size k = 0; k < p->n_moving; k++)
        load_sizes<double>(p->moving[k].plan, &p->moving[k].numbers, factors + p->moving[k].factor,
                           r->q, r->v, r->of_load, left.data());
    for (double &each : left)
        each *= tolerance;
    for (int velocity = 0; known && velocity <= p->velocity; velocity++) {
        const double *x = velocity ? r->v : r->q, *f = velocity ? r->f_v : r->f_q;
        if (!p->own) {
            std::fill(values.begin(), values.end(), 0.0);
            load_tangents(p, r, factors, velocity, values.data());
            f = values.data();
        }
        for (Size i = 0; i < p->n_q; i++)
            for (int32_t e = p->K.first[i]; e < p->K.first[i + 1]; e++)
                left[i] += ROUNDINGS * DBL_EPSILON * fabs(f[e] * x[p->K.columns[e]]);
    }
    return size_of<double>(p->n_q, left.data(), p->inverse);
}

/* Newton's method for one step from the guess in a and lam, where the solution stands then; whether
 * the residual there is finite comes with it.
 *
 * The matrix evaluated at the predictor is kept while corrections shrink quickly (measured at 1e-14:
 * 2 iterations a step; 5 with the matrix of the previous step, 3 if that is reused once only). */
template <class T>
int iterated(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const Before<T> *b,
             const T *of_joints, const T *of_loads, int small, double motion_before, int finite,
             const Attempt<T> *how, Ending *ending)
{
    const MarchRules *rules = &p->rules;
    double last = INFINITY, gap_before = INFINITY, tolerance = how->tolerance;
    double motion = motion_before > DBL_MIN ? rules->jump * motion_before : INFINITY;
    int fresh = 1, settled = 0, lag = tolerance == rules->tolerance ? LAG<T> : 0;
    ending->size = INFINITY, ending->slowest = 0;
    for (Size i = 0; (double)i < how->iterations + lag; i++) {
        r->counts[0]++;
        if (!(i ? residual_at<T>(p, r, c, b, of_joints, of_loads, small) : finite))
            return RESIDUAL_NOT_FINITE;
        double gap = unbalanced<T>(p, r);
        int failed = corrected(p, r, c, of_loads + AT_END * p->n_factors, fresh,
                               settled ? TO_ROUND_OFF : ENOUGH);
        if (failed)
            return failed;
        for (Size k = 0; k < p->n_q; k++)
            r->a[k] -= r->x[k];
        for (Size k = 0; k < p->n_lam; k++)
            r->lam[k] -= r->x[p->n_q + k];
        /* A diverging iterate has huge forces; measured against those any correction looks small.
         * So the smallest motion met counts. */
        double now = motion_of<T>(p, r, r->a);
        motion = now < motion ? now : motion;
        reaction_of<T>(p, r, r->x + p->n_q, r->force);
        double size =
            (size_of<T>(p->n_q, r->x, p->weights) + size_of<T>(p->n_q, r->force, p->inverse)) /
            motion;
        double rate = last > 0 && last < INFINITY ? fmin(size / last, 1) : size > 0;
        ending->size = size;
        /* Corrections of a fresh matrix are round-off; of stiff bodies far from balance corrections
         * are small too, and forces must balance. */
        int stuck = fresh && rate > 0.5 && size <= rules->round_off &&
                    gap <= rules->round_off * now;
        if (!stuck && i >= USUAL && lost<T>(p, r->q, c->in_q * size_of<T>(p->n_q, r->x, p->weights)))
            stuck = gap <= at_rest<T>(p, r, of_loads + AT_END * p->n_factors, rules->tolerance);
        if (!stuck && last < INFINITY && size > rules->round_off) {
            ending->slowest = fmax(ending->slowest, rate);
            if (rate > how->allowed)
                return NO_CONVERGENCE;
        }
        /* The first correction may be a motion and the second one a strain: then only forces, beyond
         * their round-off, show how far the next one is. */
        double falls = gap > rules->round_off * now ? fmin(gap / gap_before, 1) : 0;
        double slower = last < INFINITY ? fmax(rate, falls) : rate;
        /* Quadratic convergence squares the rate again. */
        double left = size * (fresh ? fmin(1, slower * slower) : slower / fmax(1 - slower, 1e-3));
        if (settled || stuck || left <= tolerance || size <= tolerance) {
            if (settled++ == 0)
                r->counts[2] += stuck || blurred<T>(p, r);
            ending->motion = now;
            if (settled > lag)
                return 0;
            /* The matrix of the solution gives the imaginary part, and then its round-off. With the
             * one before it shrinks as the real part has, which may begin far nearer. */
            fresh = settled == 1;
        } else if (last < INFINITY)
            fresh = rate > rules->slow ||
                    (size < rules->near && size * (rate * rate * rate) > tolerance);
        else
            fresh = size > rules->slow || how->allowed < INFINITY;
        last = size, gap_before = gap;
    }
    return NO_CONVERGENCE;
}

/* The same from the guess that is asked for, or a step ahead. Where that is far from balance it is
 * tried from the state before the step first.
 *
 * A wave far faster than the steps (omega h >> 1) has accelerations omega^2 u, and the line through
 * them leads (omega h)^2/2 times its amplitude u away: sections are turned inside out there, and
 * Newton's method finds the solution that they have so. Where corrections from the state before do
 * not shrink quickly from the first one on, the solution that they lead to may be another one. */
template <class T>
int guessed(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const Before<T> *b,
            const T *of_joints, const T *of_loads, int small, double motion,
            const Attempt<T> *how, Ending *ending)
{
    auto residual = [&] { return residual_at<T>(p, r, c, b, of_joints, of_loads, small); };
    auto solved = [&](int finite, const Attempt<T> *way) {
        return iterated<T>(p, r, c, b, of_joints, of_loads, small, motion, finite, way, ending);
    };
    if (how->a) {
        memcpy(r->a, how->a, (size_t)p->n_q * sizeof(T));
        memcpy(r->lam, how->lam, (size_t)p->n_lam * sizeof(T));
        return solved(residual(), how);
    }
    look_ahead<T>(p, r, b, motion);
    int finite = residual();
    double ahead = unbalanced<T>(p, r);
    if (ahead <= p->rules.jump * motion)
        return solved(finite, how);
    for (Size i = 0; i < p->n_q; i++)
        r->a[i] = -r->dq_p[i] / c->in_q;
    finite = residual();
    if (!(unbalanced<T>(p, r) > p->rules.smooth * ahead)) { /* Else a load has grown. */
        const Attempt<T> close = {nullptr, nullptr, p->rules.tolerance, CLOSE,
                                  p->rules.max_iterations};
        int failed = solved(finite, &close);
        if (!failed || failed == INDEFINITE)
            return failed;
    }
    look_ahead<T>(p, r, b, motion);
    return solved(residual(), how);
}

/* One step from b; of the state after it a stays in the room. */
template <class T>
int stepped(const Plan<T> *p, Room<T> *r, const StepCoefficients *c, const Before<T> *b,
            const T *of_joints, Size instants, const T *of_loads, const Attempt<T> *how,
            Ending *ending)
{
    double motion = motion_before<T>(p, r, b, of_joints, of_loads);
    double noise = DBL_EPSILON * size_of<T>(p->n_q, b->q, p->weights);
    double allowed = p->rules.quiet * motion * c->in_q;
    int small = p->n_lam && !(noise <= allowed);
    if (small && instants < ALL_INSTANTS)
        return NEEDS_GAUSS;
    real_room(p, r)->exchanging = 0;
    predict<T>(p, r, c, b);
    if (small) {
        const T *at_start[1];
        at_instant<T>(p, r, of_joints, AT_START, 0, at_start);
        constraint_at<T>(p, r, 0, at_start, b->q, nullptr, r->defect);
        for (Size i = 0; i < p->n_lam; i++)
            r->defect[i] *= allowed / noise;
    }
    r->c[0] = p->own ? of_joints + AT_END : p->numbers.part_0;
    if (!p->still && !p->own)
        coefficients<T>(p->constraints, &p->numbers, 0, 0, 1,
                        of_joints + AT_END * p->constraints->n_parts, r->at_end, r->c);
    return guessed<T>(p, r, c, b, of_joints, of_loads, small, motion, how, ending);
}

/* As many of k steps of sizes h as can be taken until the clock says so; the states after them are
 * rows of q, v, A and lam. Tables of factors have `instants` rows of joints, two of loads, or are
 * empty. `ends` tells why no more are taken; what stands in b belongs to the last state then. What a
 * step alone costs counts even where it is not solved. */
template <class T>
Size marched(const Plan<T> *p, Room<T> *r, Before<T> *b, Size k, const double *h, Size instants,
             const T *of_joints, const T *of_loads, double until, const Attempt<T> *how,
             T *const out[4], T *a, int *ends, Ending *ending)
{
    Size sizes[] = {p->n_q, p->n_q, p->n_q, p->n_lam}, n_q = p->n_q;
    for (Size n = 0; n < k; n++) {
        StepCoefficients c = coefficients_of_step(h[n], p->rules.alpha);
        Size counts[3];
        double ratio = n ? h[n] / h[n - 1] : 1;
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
                           instants, of_loads + n * 2 * p->n_factors, how, ending);
        if (*ends) {
            if (k > 1 || *ends < NO_CONVERGENCE)
                memcpy(r->counts, counts, sizeof counts);
            return n;
        }
        T *row[4];
        for (int i = 0; i < 4; i++)
            row[i] = out[i] + n * sizes[i];
        state_of<T>(p, r, &c, b->A, r->a, row[0], row[1], row[2]);
        memcpy(row[3], r->lam, (size_t)p->n_lam * sizeof(T));
        memcpy(a, r->a, (size_t)n_q * sizeof(T));
        Before<T> after = {row[0], row[1], a, row[3], row[2], ending->motion};
        *b = after;
    }
    *ends = ALL_TAKEN;
    return k;
}

/* A run of HHT-I3 under error control (control.h): the tolerance, whose vectors count from a place,
 * where the run stands, and rows of states: rows of `marched`, with a and sizes of the motion. */
template <class T> struct ControlledRun final : StepRun {
    const Plan<T> *plan;
    Room<T> *room;
    StepLaws<T> *laws;
    const Attempt<T> *how;
    StepTolerance tolerance;
    const double *place;
    Before<T> first;
    T *rows[4], *a;
    double *motion;
    Ending ending;

    int tried(double h, double end, double *e) override;
};

/* The state after some of the steps. */
template <class T> Before<T> state_after(const ControlledRun<T> *c, Size steps)
{
    Size n_q = c->plan->n_q, k = steps - 1;
    if (steps == 0)
        return c->first;
    return {c->rows[0] + k * n_q, c->rows[1] + k * n_q,           c->a + k * n_q,
            c->rows[3] + k * c->plan->n_lam, c->rows[2] + k * n_q, c->motion[k]};
}

/* Error e of a step of HHT-I3 by the rise of a, with the sizes of vectors before and behind it. */
template <class T>
double step_error(const ControlledRun<T> *c, double h, const T *before, const T *after,
                  const T *a_before, const T *a)
{
    double alpha = c->plan->rules.alpha, scale = -(1 + 3 * (alpha * alpha)) / 12 * (h * h);
    double share = c->filter->t_end / h;
    auto defect = [&](Size k) { return scale * real_part(a[k] - a_before[k]) * share; };
    return error_against(c->tolerance, before, after, c->place, defect, [](Size) { return 0.0; });
}

template <class T> int ControlledRun<T>::tried(double h, double end, double *e)
{
    const Plan<T> *p = plan;
    Room<T> *r = room;
    StepTables<T> tables;
    if (!laws->at(t, end, h, &tables))
        return LAW_RAISED;
    Before<T> old = state_after(this, taken), begin = old;
    StepCoefficients of = coefficients_of_step(h, p->rules.alpha);
    double ratio = h / last;
    Size counts[3];
    if (ratio != 1) {
        for (Size i = 0; i < p->n_q; i++)
            r->start[i] = old.A[i] + ratio * (old.a[i] - old.A[i]);
        begin.a = r->start;
    }
    memcpy(counts, r->counts, sizeof counts);
    int failed = stepped<T>(p, r, &of, &begin, tables.of_joints, tables.instants, tables.of_loads,
                            how, &ending);
    if (failed && failed < NO_CONVERGENCE)
        memcpy(r->counts, counts, sizeof counts);
    if (failed)
        return failed;
    Size k = taken;
    T *q = rows[0] + k * p->n_q, *to = a + k * p->n_q;
    state_of<T>(p, r, &of, old.A, r->a, q, rows[1] + k * p->n_q, rows[2] + k * p->n_q);
    memcpy(rows[3] + k * p->n_lam, r->lam, (size_t)p->n_lam * sizeof(T));
    memcpy(to, r->a, (size_t)p->n_q * sizeof(T));
    motion[k] = ending.motion;
    *e = larger_error(tables.turn, step_error<T>(this, h, old.q, q, begin.a, to));
    return 0;
}
