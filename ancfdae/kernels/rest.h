/* Newton's method for equilibria under part of the load (docs/theory, statics), for one scalar type.
 *
 * `statics/balance.py` says what the equations are, and what stops an iteration. Matrices are real.
 */

/* How a search ends: solved, or not, for want of digits that the matrix has lost, of a band that an
 * indefinite matrix needs, or since corrections have stopped shrinking. */
enum {
    REST_SOLVED,
    REST_NO_CONVERGENCE,
    REST_NOT_FINITE,
    REST_SINGULAR,
    REST_INDEFINITE,
    REST_STUCK
};

/* Load fraction, mu, part of Phi_0 that is left and that it loses per s, sizes of positions and
 * loads at the start, and the rules of `balance.py`; the diagonal is shifted by that part of itself
 * to see whether K is positive definite. */
struct RestRules {
    double s, mu, gap, closing, position, load, tolerance, far, growths, iterations, shift;
};

/* The equations; factors of loads as they act, and of loads that turn. A system of one's own has the
 * time in place of factors, and one that says whether loads turn. */
template <class T> struct RestProblem {
    RestRules rules;
    const T *q_0, *anchor, *r_0, *Phi_0, *of_joints, *of_loads, *of_turning;
};

/* A state, its path in s or where corrections are stuck the last one, and what is told of it. */
template <class T> struct RestState {
    T *q, *lam, *q_s, *lam_s;
    double size;
    int iterations, definite;
};

/* Add s P, loads that turn in a system of one's own, to Q, and s P_q to the tangent, or nullptr. */
template <class T>
void rest_turned(const Plan<T> *p, Room<T> *r, const T *of_loads, const T *of_turning, double s,
                 T *Q, T *tangent)
{
    if (!p->own || s == 0 || !(of_turning[0] != 0) ||
        !p->own->following(of_loads[0], r->q, r->inner, tangent ? r->turned : nullptr))
        return;
    for (Size i = 0; Q && i < p->n_q; i++)
        Q[i] += s * r->inner[i];
    for (Size i = 0; tangent && i < p->nnz; i++)
        tangent[i] += s * r->turned[i];
}

/* The right side of a correction at r->q and r->lam; whether it is finite. */
template <class T> int rest_residual(const Plan<T> *p, Room<T> *r, const RestProblem<T> *x)
{
    double left = 1 - x->rules.s;
    T sum = 0, *R = r->R;
    constraint_at<T>(p, r, 0, r->c, r->q, nullptr, r->Phi);
    jacobian_at<T>(p, r, r->c, r->q);
    reaction_of<T>(p, r, r->lam, r->reaction);
    force_at<T>(p, r, x->of_loads, r->q, r->v);
    rest_turned<T>(p, r, x->of_loads, x->of_turning, -left, r->Q, nullptr);
    memset(R, 0, (size_t)p->n_q * sizeof(T));
    if (x->anchor) {
        for (Size i = 0; i < p->n_q; i++)
            r->force[i] = x->rules.mu * (x->anchor[i] - r->q[i]);
        csr_times<T>(&p->M, r->force, R);
    }
    for (Size i = 0; i < p->n_q; i++) {
        R[i] += r->Q[i] - r->reaction[i] - left * x->r_0[i];
        sum += 0 * R[i];
    }
    for (Size i = 0; i < p->n_lam; i++) {
        R[p->n_q + i] = x->rules.gap * x->Phi_0[i] - r->Phi[i];
        sum += 0 * R[p->n_q + i];
    }
    return sum == 0;
}

/* f_q at the real part of r->q and r->lam; the diagonal of f_q + mu M goes to A of the real room. */
template <class T>
RealState rest_tangent(const Plan<T> *of, Room<T> *from, const RestProblem<T> *x)
{
    memset(from->A, 0, (size_t)of->n_q * sizeof(T));
    auto [p, r, of_loads] = real_state(of, from, x->of_loads);
    const double turns = p->own ? real_part(*x->of_turning) : 0;
    const Csr<double> *K = &p->K;
    if (p->own) {
        p->own->tangents(of_loads[0], r->q, r->v, r->A, r->lam, r->f_q, r->f_v);
        rest_turned<double>(p, r, of_loads, &turns, 1 - x->rules.s, nullptr, r->f_q);
    } else {
        memset(r->f_q, 0, (size_t)p->nnz * sizeof(double));
        tangents<double>(p->n_y, p->d, &p->block, r->q, nullptr, 0, p->index, p->nnz, r->f_q);
        curvature_at(p, r);
        load_tangents(p, r, of_loads, 0, r->f_q);
    }
    for (Size i = 0; i < p->n_q; i++)
        for (int32_t k = K->first[i]; k < K->first[i + 1]; k++)
            if (K->columns[k] == i)
                r->A[i] = r->f_q[k] + x->rules.mu * K->values[k];
    return {p, r, of_loads};
}

/* Weight of constraint k in K + B^T C B, which is positive definite where K is on all motions that
 * keep the constraints; as stiff as its coordinates. */
double rest_weight(const Plan<double> *p, const Room<double> *r, Size k)
{
    double stiffness = 0, square = 0;
    for (int32_t i = p->B.first[k]; i < p->B.first[k + 1]; i++) {
        stiffness = fmax(stiffness, fabs(r->A[p->B.columns[i]]));
        square += r->B[i] * r->B[i];
    }
    return square > 0 ? stiffness / square : 0;
}

/* L D L^T of [f_q + mu M + B^T C B - shift D, B^T; B, 0]; whether all pivots have their signs. */
int rest_definite(const Plan<double> *p, Room<double> *r, double mu, double shift)
{
    Size n = p->n_q + p->n_lam;
    int *place = r->pivots;
    double most = 0;
    if (!p->first)
        return 0;
    for (Size i = 0; i < n; i++)
        place[p->order[i]] = (int)i;
    memset(r->matrix, 0, (size_t)p->first[n] * sizeof(double));
    if (mu)
        ldl_placed<double>(p->n_chosen, p->chosen, p->places, mu, p->K.values, r->matrix);
    ldl_placed<double>(p->n_chosen, p->chosen, p->places, 1, r->f_q, r->matrix);
    ldl_placed<double>(p->constraints->n_values, nullptr, p->places + p->n_chosen, 1, r->B,
                       r->matrix);
    for (Size k = 0; k < p->n_lam; k++) {
        double weight = rest_weight(p, r, k);
        for (int32_t i = p->B.first[k]; i < p->B.first[k + 1]; i++)
            for (int32_t j = p->B.first[k]; j < p->B.first[k + 1]; j++) {
                int column = place[p->B.columns[i]], row = place[p->B.columns[j]];
                if (row >= column)
                    r->matrix[p->first[column] + row - column] += weight * r->B[i] * r->B[j];
            }
    }
    for (Size i = 0; shift && i < p->n_q; i++)
        most = fmax(most, fabs(r->A[i]) * p->inverse[i]);
    for (Size i = 0; shift && i < p->n_q; i++)
        r->matrix[p->first[place[i]]] -= shift * fmax(fabs(r->A[i]), 1e-8 * most * p->weights[i]);
    return ldl_factor<double>(n, p->first, p->signs, r->matrix, r->least) == 0;
}

/* Factorise: 0, REST_SINGULAR or REST_INDEFINITE. */
int rest_factored(const Plan<double> *p, Room<double> *r, const StepCoefficients *c)
{
    r->factored = BY_ENVELOPE, r->exchanging = 0;
    if (rest_definite(p, r, c->in_A, 0))
        return 0;
    int failed = factor_sum_out_of_envelope(p, r, c, r->f_q, nullptr, r->B);
    return failed == INDEFINITE ? +REST_INDEFINITE : failed ? +REST_SINGULAR : 0;
}

/* r->x for the right side r->R; whether there are no digits. */
template <class T> int rest_solved(const Plan<T> *of, Room<T> *from, const StepCoefficients *c)
{
    const Plan<double> *p = real_plan(of);
    Room<double> *r = real_room(of, from);
    Size n = p->n_q + p->n_lam;
    double *rows = r->columns, *x = rows + 2 * n;
    parted<T>(n, from->R, rows);
    for (Size k = 0; r->factored == BY_ENVELOPE && k < p->n_lam; k++)
        for (Size part = 0; part < PARTS<T>; part++) {
            double *row = rows + part * n, force = rest_weight(p, r, k) * row[p->n_q + k];
            for (int32_t i = p->B.first[k]; i < p->B.first[k + 1]; i++)
                row[p->B.columns[i]] += force * r->B[i];
        }
    int failed = solved_rows(p, r, c, 'N', TO_ROUND_OFF, PARTS<T>, rows, x);
    for (Size i = 0; i < n; i++)
        from->x[i] = joined(x + i, n, T(0));
    return failed;
}

/* dq/ds and dlam/ds with the factors that there are; whether there are no digits. */
template <class T>
int rest_path(const Plan<T> *p, Room<T> *r, const RestProblem<T> *x, const StepCoefficients *c,
              RestState<T> *to)
{
    memcpy(r->R, x->r_0, (size_t)p->n_q * sizeof(T));
    rest_turned<T>(p, r, x->of_loads, x->of_turning, 1, r->R, nullptr);
    for (Size k = 0; k < p->n_moving; k++)
        load_force<T>(p->moving[k].plan, &p->moving[k].numbers,
                           x->of_turning + p->moving[k].factor, r->q, r->v, r->of_load, r->R);
    for (Size i = 0; i < p->n_lam; i++)
        r->R[p->n_q + i] = -x->rules.closing * x->Phi_0[i];
    int failed = rest_solved<T>(p, r, c);
    memcpy(to->q_s, r->x, (size_t)p->n_q * sizeof(T));
    memcpy(to->lam_s, r->x + p->n_q, (size_t)p->n_lam * sizeof(T));
    return failed;
}

/* Sizes of the correction r->x that led to r->q and r->lam: of positions, and the larger one. */
template <class T>
double rest_moved(const Plan<T> *p, Room<T> *r, const RestProblem<T> *x, double *size)
{
    double moved = size_of<T>(p->n_q, r->x, p->weights), scale = x->rules.position;
    for (Size i = 0; i < p->n_q; i++)
        r->force[i] = r->q[i] - x->q_0[i];
    scale = scale ? scale : size_of<T>(p->n_q, r->force, p->weights);
    moved /= scale ? scale : 1;
    reaction_of<T>(p, r, r->lam, r->force);
    double force = fmax(x->rules.load, size_of<T>(p->n_q, r->force, p->inverse));
    reaction_of<T>(p, r, r->x + p->n_q, r->force);
    *size = fmax(moved, size_of<T>(p->n_q, r->force, p->inverse) / force);
    return moved;
}

/* Corrections from r->q and r->lam until they converge. */
template <class T>
int rest_iterated(const Plan<T> *p, Room<T> *r, const RestProblem<T> *x,
                  const StepCoefficients *c, RestState<T> *to)
{
    double last = INFINITY;
    int growths = 0, settled = 0;
    for (to->iterations = 1; to->iterations <= x->rules.iterations; to->iterations++) {
        if (!rest_residual<T>(p, r, x))
            return REST_NOT_FINITE;
        RealState real = rest_tangent<T>(p, r, x);
        int failed = rest_factored(real.plan, real.room, c);
        if (failed || (failed = rest_solved<T>(p, r, c) ? +REST_SINGULAR : 0))
            return failed;
        for (Size i = 0; i < p->n_q; i++)
            r->q[i] += r->x[i];
        for (Size i = 0; i < p->n_lam; i++)
            r->lam[i] += r->x[p->n_q + i];
        double moved = rest_moved<T>(p, r, x, &to->size);
        double rate = last > 0 && last < INFINITY ? moved / last : moved > 0;
        growths += rate > 1;
        settled += settled || to->size * fmin(1, rate * rate) <= x->rules.tolerance;
        if (settled > LAG<T>)
            return REST_SOLVED;
        memcpy(to->q_s, r->x, (size_t)p->n_q * sizeof(T));
        memcpy(to->lam_s, r->x + p->n_q, (size_t)p->n_lam * sizeof(T));
        if (moved > x->rules.far || growths >= x->rules.growths)
            return REST_NO_CONVERGENCE;
        if (!settled && last < INFINITY && rate > 0.5 && to->size < sqrt(x->rules.tolerance))
            return REST_STUCK;
        last = moved;
    }
    to->iterations--;
    return REST_NO_CONVERGENCE;
}

/* Solve from the state given; with no iterations only its path is found. */
template <class T>
int rested(const Plan<T> *p, Room<T> *r, const RestProblem<T> *x, RestState<T> *to)
{
    size_t of_q = (size_t)p->n_q * sizeof(T), of_lam = (size_t)p->n_lam * sizeof(T);
    const StepCoefficients c = {0, 0, 0, 0, 1, 0, x->rules.mu};
    int why = REST_SOLVED;
    memset(r->v, 0, of_q);
    r->B_known = 0;
    r->c[0] = p->own ? x->of_joints : p->numbers.part_0;
    if (!p->still && !p->own)
        coefficients<T>(p->constraints, &p->numbers, 0, 0, 1, x->of_joints, r->at_end, r->c);
    if (p->own) { /* M belongs to the start. */
        memcpy(r->q, x->q_0, of_q);
        mass_at<T>(p, r, r->q);
        RealState start = real_state(p, r, x->of_loads);
        mass_at<double>(start.plan, start.room, start.room->q);
    }
    memcpy(r->q, to->q, of_q);
    memcpy(r->lam, to->lam, of_lam);
    to->definite = 0;
    if (x->rules.iterations > 0)
        why = rest_iterated<T>(p, r, x, &c, to);
    else {
        jacobian_at<T>(p, r, r->c, r->q);
        RealState real = rest_tangent<T>(p, r, x);
        why = rest_factored(real.plan, real.room, &c);
    }
    memcpy(to->q, r->q, of_q);
    memcpy(to->lam, r->lam, of_lam);
    if (why != REST_SOLVED)
        return why;
    if (rest_path<T>(p, r, x, &c, to))
        return REST_SINGULAR;
    jacobian_at<T>(p, r, r->c, r->q);
    RealState real = rest_tangent<T>(p, r, x);
    to->definite = rest_definite(real.plan, real.room, x->rules.mu, x->rules.shift);
    return why;
}
