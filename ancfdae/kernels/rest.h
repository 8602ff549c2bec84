/* Newton's method for equilibria under part of the load (docs/theory, statics), in real numbers.
 *
 * `statics/balance.py` says what the equations are, and what stops an iteration.
 */

/* How a search ends: solved, or not, for want of digits that the matrix has lost, of a band that an
 * indefinite matrix needs, or left to the way of before since it is stuck. */
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

/* The equations; factors of loads as they act, and of those that turn. */
struct RestProblem {
    RestRules rules;
    const double *q_0, *anchor, *r_0, *Phi_0, *of_joints, *of_loads, *of_turning;
};

/* A state, its path in s, and what is told of it. */
struct RestState {
    double *q, *lam, *q_s, *lam_s, size;
    int iterations, definite;
};

/* The right side of a correction at r->q and r->lam; whether it is finite. */
int rest_residual(const Plan<double> *p, Room<double> *r, const RestProblem *x)
{
    double left = 1 - x->rules.s, sum = 0, *R = r->R;
    constraint_at<double>(p, r, r->c, r->q, nullptr, r->Phi);
    jacobian_at<double>(p, r, r->c, r->q);
    reaction_of<double>(p, r, r->lam, r->reaction);
    force_at<double>(p, r, x->of_loads, r->q, r->v);
    memset(R, 0, (size_t)p->n_q * sizeof(double));
    if (x->anchor) {
        for (Size i = 0; i < p->n_q; i++)
            r->force[i] = x->rules.mu * (x->anchor[i] - r->q[i]);
        csr_times<double>(&p->M, r->force, R);
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

/* f_q at r->q and r->lam; its diagonal, with that of mu M, to r->A. */
void rest_tangent(const Plan<double> *p, Room<double> *r, const RestProblem *x)
{
    const Csr<double> *K = &p->K;
    memset(r->f_q, 0, (size_t)p->nnz * sizeof(double));
    tangents<double>(p->n_y, p->d, &p->block, r->q, nullptr, 0, p->index, p->nnz, r->f_q);
    constraint_curvature<double>(p->constraints, p->numbers.l, r->c[0], r->lam, r->f_q);
    load_tangents<double>(p, r, x->of_loads, 0, r->f_q);
    for (Size i = 0; i < p->n_q; i++)
        for (int32_t k = K->first[i]; k < K->first[i + 1]; k++)
            if (K->columns[k] == i)
                r->A[i] = r->f_q[k] + x->rules.mu * K->values[k];
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
int rest_factored(const Plan<double> *p, Room<double> *r, double mu)
{
    r->factored = BY_ENVELOPE;
    if (rest_definite(p, r, mu, 0))
        return 0;
    if (!p->flat)
        return REST_INDEFINITE;
    StepCoefficients c = {0, 0, 0, 0, 1, 0, mu};
    return banded_sum<double>(p, r, &c, r->f_q, nullptr, r->B) ? REST_SINGULAR : 0;
}

/* r->x for the right side r->R, which it changes. */
void rest_solved(const Plan<double> *p, Room<double> *r)
{
    for (Size k = 0; r->factored == BY_ENVELOPE && k < p->n_lam; k++) {
        double force = rest_weight(p, r, k) * r->R[p->n_q + k];
        for (int32_t i = p->B.first[k]; i < p->B.first[k + 1]; i++)
            r->R[p->B.columns[i]] += force * r->B[i];
    }
    solve_rows<double>(p, r, 'N', TO_ROUND_OFF, 1, r->R, r->x);
}

/* dq/ds and dlam/ds with the factors that there are. */
void rest_path(const Plan<double> *p, Room<double> *r, const RestProblem *x, RestState *to)
{
    memcpy(r->R, x->r_0, (size_t)p->n_q * sizeof(double));
    for (Size k = 0; k < p->n_moving; k++)
        load_force<double>(p->moving[k].plan, &p->moving[k].numbers,
                           x->of_turning + p->moving[k].factor, r->q, r->v, r->of_load, r->R);
    for (Size i = 0; i < p->n_lam; i++)
        r->R[p->n_q + i] = -x->rules.closing * x->Phi_0[i];
    rest_solved(p, r);
    memcpy(to->q_s, r->x, (size_t)p->n_q * sizeof(double));
    memcpy(to->lam_s, r->x + p->n_q, (size_t)p->n_lam * sizeof(double));
}

/* Sizes of the correction r->x that led to r->q and r->lam: of positions, and the larger one. */
double rest_moved(const Plan<double> *p, Room<double> *r, const RestProblem *x, double *size)
{
    double moved = size_of<double>(p->n_q, r->x, p->weights), scale = x->rules.position;
    for (Size i = 0; i < p->n_q; i++)
        r->force[i] = r->q[i] - x->q_0[i];
    scale = scale ? scale : size_of<double>(p->n_q, r->force, p->weights);
    moved /= scale ? scale : 1;
    reaction_of<double>(p, r, r->lam, r->force);
    double force = fmax(x->rules.load, size_of<double>(p->n_q, r->force, p->inverse));
    reaction_of<double>(p, r, r->x + p->n_q, r->force);
    *size = fmax(moved, size_of<double>(p->n_q, r->force, p->inverse) / force);
    return moved;
}

/* Corrections from r->q and r->lam until they converge. */
int rest_iterated(const Plan<double> *p, Room<double> *r, const RestProblem *x, RestState *to)
{
    double last = INFINITY;
    int growths = 0;
    for (to->iterations = 1; to->iterations <= x->rules.iterations; to->iterations++) {
        if (!rest_residual(p, r, x))
            return REST_NOT_FINITE;
        rest_tangent(p, r, x);
        int failed = rest_factored(p, r, x->rules.mu);
        if (failed)
            return failed;
        rest_solved(p, r);
        for (Size i = 0; i < p->n_q; i++)
            r->q[i] += r->x[i];
        for (Size i = 0; i < p->n_lam; i++)
            r->lam[i] += r->x[p->n_q + i];
        double moved = rest_moved(p, r, x, &to->size);
        double rate = last > 0 && last < INFINITY ? moved / last : moved > 0;
        growths += rate > 1;
        if (to->size * fmin(1, rate * rate) <= x->rules.tolerance)
            return REST_SOLVED;
        if (moved > x->rules.far || growths >= x->rules.growths)
            return REST_NO_CONVERGENCE;
        if (last < INFINITY && rate > 0.5 && to->size < sqrt(x->rules.tolerance))
            return REST_STUCK;
        last = moved;
    }
    return REST_NO_CONVERGENCE;
}

/* Solve from the state given; with no iterations only its path is found. */
int rested(const Plan<double> *p, Room<double> *r, const RestProblem *x, RestState *to)
{
    size_t of_q = (size_t)p->n_q * sizeof(double), of_lam = (size_t)p->n_lam * sizeof(double);
    int why = REST_SOLVED;
    memcpy(r->q, to->q, of_q);
    memcpy(r->lam, to->lam, of_lam);
    memset(r->v, 0, of_q);
    r->B_known = 0;
    r->c[0] = p->numbers.part_0;
    if (!p->still)
        coefficients<double>(p->constraints, &p->numbers, 0, 0, 1, x->of_joints, r->at_end, r->c);
    to->definite = 0;
    if (x->rules.iterations > 0)
        why = rest_iterated(p, r, x, to);
    else {
        jacobian_at<double>(p, r, r->c, r->q);
        rest_tangent(p, r, x);
        why = rest_factored(p, r, x->rules.mu);
    }
    memcpy(to->q, r->q, of_q);
    memcpy(to->lam, r->lam, of_lam);
    if (why != REST_SOLVED)
        return why;
    rest_path(p, r, x, to);
    jacobian_at<double>(p, r, r->c, r->q);
    rest_tangent(p, r, x);
    to->definite = rest_definite(p, r, x->rules.mu, x->rules.shift);
    return why;
}
