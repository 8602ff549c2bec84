/* Derivative recurrences of Radau IIA over computed steps (docs/theory/14-radau.md), in real numbers.
 *
 * `integrators/radau/linear_passes.py` states them. Rows belong to the stages of all steps in their order:
 * values of matrices there, of which M has one row where it is constant.
 */

struct ComputedStages {
    Size k, rows_of_M;
    const double *h, *M, *Phi_q, *f_q, *end_q;
    const double *f_v, *end_v;    /* nullptr where forces do not use velocities */
    const double *held_q;         /* nullptr where M and Phi_q do not move */
    const double *rate, *rate_2;  /* Phi'_q and Phi''_q; nullptr where both vanish */
};

/* A pass over steps, with room: derivatives of a stage and right sides of all stages for n_b rows. */
struct StagePass {
    const Plan<double> *plan;
    Room<double> *room;
    const StageTableau *tableau;
    const ComputedStages *stages;
    StageMatrix *matrix;
    Size n_b;
    double *straight, *side, *x, *all;
};

/* Find (a, lam) and (v - V, sigma) of k stages, rows of `found`, from q, V and rough accelerations,
 * from stage `first` on; returns the number of the next. */
Size stages_found(const Plan<double> *p, Room<double> *r, Size k, Size first, const double *of_joints,
                  const double *of_loads, const double *q, const double *V, const double *A,
                  double *found, int *ends)
{
    Size n_q = p->n_q, n_lam = p->n_lam, n = n_q + n_lam;
    std::unique_ptr<double[]> right(new double[(size_t)(2 * n)]);
    for (Size i = first; i < k; i++) {
        const double *c[2] = {p->own ? of_joints + i : p->numbers.part_0, nullptr};
        if (!p->own && !p->still)
            coefficients<double>(p->constraints, &p->numbers, 1, i, k, of_joints, r->within, c);
        mass_at<double>(p, r, q + i * n_q);
        jacobian_at<double>(p, r, c, q + i * n_q);
        if ((*ends = mass_factorised(p, r)))
            return i;
        memset(right.get(), 0, (size_t)(2 * n) * sizeof(double));
        force_at<double>(p, r, of_loads + i * p->n_factors, q + i * n_q, V + i * n_q);
        memcpy(right.get(), r->Q, (size_t)n_q * sizeof(double));
        csr_rows<double>(n_lam, p->B.first, p->B.columns, r->B, 1, n_q, A + i * n_q, r->work, 1, n,
                         right.get() + n_q);
        constraint_at<double>(p, r, 1, c, q + i * n_q, V + i * n_q, r->Phi);
        for (Size e = 0; e < n_lam; e++)
            right[(size_t)(n + n_q + e)] = -r->Phi[e];
        if ((*ends = mass_solved(p, r, 'N', 2, right.get(), found + 2 * i * n)))
            return i;
    }
    return k;
}

/* Values of a matrix at stage i of a step, nullptr without any. */
const double *at_stage(const double *values, Size i, Size size)
{
    return values ? values + i * size : nullptr;
}

/* out += s K x for n_b rows with values on the pattern of K, or of B; nothing without values. */
void add_product(const StagePass *s, const Csr<double> *of, const double *values, double factor,
                 const double *x, double *out)
{
    const Plan<double> *p = s->plan;
    if (values)
        csr_rows<double>(of->n, of->first, of->columns, values, s->n_b, p->n_q, x, s->room->work,
                         factor, p->n_q + p->n_lam, out);
}

/* out += s K^T x for one row. */
void add_transposed(const StagePass *s, const Csr<double> *of, const double *values, double factor,
                    const double *x, double *out)
{
    if (values)
        csr_rows_transposed<double>(of->n, of->first, of->columns, values, 1, x, factor,
                                    s->plan->n_q, out);
}

/* Factorise the coupled matrix of step i: whether it is singular. */
bool pass_singular(const StagePass *s, Size step)
{
    const Plan<double> *p = s->plan;
    const ComputedStages *of = s->stages;
    Size n_B = p->constraints->n_values;
    for (int i = 0; i < STAGES; i++) {
        Size at = step * STAGES + i;
        stage_blocks(s->matrix, s->tableau, of->h[step], i, p->nnz,
                     of->M + (of->rows_of_M > 1 ? at * p->nnz : 0), of->f_q + at * p->nnz,
                     at_stage(of->f_v, at, p->nnz));
    }
    memcpy(s->matrix->B, of->Phi_q + step * STAGES * n_B, (size_t)(STAGES * n_B) * sizeof(double));
    return stage_matrix_singular(s->matrix, STAGES * (p->n_q + p->n_lam), STAGES * n_B);
}

/* Factorise M and Phi_q of a stage. */
int stage_mass_factorised(const StagePass *s, Size at)
{
    const Plan<double> *p = s->plan;
    Size n_B = p->constraints->n_values;
    if (p->own)
        memcpy(s->room->mass, s->stages->M + (s->stages->rows_of_M > 1 ? at * p->nnz : 0),
               (size_t)p->nnz * sizeof(double));
    memcpy(s->room->B, s->stages->Phi_q + at * n_B, (size_t)n_B * sizeof(double));
    return mass_factorised(p, s->room);
}

/* Parts of n_b rows of solutions, negated. */
void negated_rows(const StagePass *s, const double *x, Size size, double *to)
{
    for (Size b = 0; b < s->n_b; b++, x += s->plan->n_q + s->plan->n_lam)
        for (Size e = 0; e < size; e++)
            *to++ = -x[e];
}

/* v_b, a_b and lam_b of a completed stage from q_b and V_b, n_b rows each; what is known of the
 * negated right sides, for v and for a, is overwritten. */
int stage_completed(const StagePass *s, Size at, const double *q_b, const double *V_b, double *moved,
                    double *ended, double *v_b, double *a_b, double *lam_b)
{
    const Plan<double> *p = s->plan;
    const ComputedStages *of = s->stages;
    const Csr<double> *K = &p->K, *B = &p->B;
    Size n_q = p->n_q, n_B = p->constraints->n_values;
    const double *rate = at_stage(of->rate, at, n_B);
    int failed = stage_mass_factorised(s, at);
    if (failed)
        return failed;
    add_product(s, &p->M, p->M.values, -1, V_b, moved);
    add_product(s, K, at_stage(of->held_q, at, p->nnz), 1, q_b, moved);
    add_product(s, B, rate, 1, q_b, moved + n_q);
    if ((failed = mass_solved(p, s->room, 'N', s->n_b, moved, s->x)))
        return failed;
    negated_rows(s, s->x, n_q, v_b);
    add_product(s, K, of->end_q + at * p->nnz, 1, q_b, ended);
    add_product(s, K, at_stage(of->end_v, at, p->nnz), 1, v_b, ended);
    add_product(s, B, at_stage(of->rate_2, at, n_B), 1, q_b, ended + n_q);
    add_product(s, B, rate, 2, v_b, ended + n_q);
    if ((failed = mass_solved(p, s->room, 'N', s->n_b, ended, s->x)))
        return failed;
    negated_rows(s, s->x, n_q, a_b);
    negated_rows(s, s->x + n_q, p->n_lam, lam_b);
    return 0;
}

/* Right sides of the stages of a step, and what follows: x_b of stages, (STAGES, n_b, n_q). `right`
 * are those known, of stages (f_b, Phi_b), n_b rows of each. */
void stage_displacements_b(const StagePass *s, Size step, const double *q_b, const double *v_b,
                           double *right, double *x_b)
{
    const Plan<double> *p = s->plan;
    const ComputedStages *of = s->stages;
    Size n_q = p->n_q, n_lam = p->n_lam, n = n_q + n_lam, size = s->n_b * n_q;
    double h = of->h[step];
    for (int i = 0; i < STAGES; i++) {
        Size at = step * STAGES + i;
        double *own = right + i * s->n_b * n;
        for (Size e = 0; e < size; e++)
            s->straight[e] = q_b[e] + h * s->tableau->c[i] * v_b[e];
        add_product(s, &p->K, of->f_q + at * p->nnz, 1, s->straight, own);
        add_product(s, &p->K, at_stage(of->f_v, at, p->nnz), 1, v_b, own);
        add_product(s, &p->B, of->Phi_q + at * p->constraints->n_values, 1, s->straight, own + n_q);
        for (Size b = 0; b < s->n_b; b++) {
            double *to = s->all + b * STAGES * n;
            memcpy(to + i * n_q, own + b * n, (size_t)n_q * sizeof(double));
            for (Size e = 0; e < n_lam; e++)
                to[STAGES * n_q + i * n_lam + e] = own[b * n + n_q + e] / (h * h);
        }
    }
    stages_solved(s->matrix, false, STAGES * n_q, STAGES * n, s->n_b, s->all);
    for (int i = 0; i < STAGES; i++)
        for (Size b = 0; b < s->n_b; b++)
            for (Size e = 0; e < n_q; e++)
                x_b[i * size + b * n_q + e] = -s->all[b * STAGES * n + i * n_q + e];
}

/* Take steps of direct differentiation from step `first` on, and return the number of the next.
 * `known` are (f_b, Phi_b) of stages and the known parts of the negated right sides of v and of a, in
 * rows of stages, and overwritten. States, rows of q_b, v_b and a_b of all instants, begin with those
 * before step 0; x_b has rows of stages. */
Size stages_differentiated(const StagePass *s, Size first, double *const known[3], double *states,
                           double *lam_b, double *x_b, int *ends)
{
    const Plan<double> *p = s->plan;
    Size n_q = p->n_q, n = n_q + p->n_lam, size = s->n_b * n_q;
    for (Size step = first; step < s->stages->k; step++) {
        double h = s->stages->h[step], *x = x_b + step * STAGES * size;
        const double *q_b = states + step * STAGES * 3 * size, *v_b = q_b + size;
        if (pass_singular(s, step))
            return *ends = MATRIX_SINGULAR, step;
        stage_displacements_b(s, step, q_b, v_b, known[0] + step * STAGES * s->n_b * n, x);
        for (int i = 0; i < STAGES; i++) {
            Size at = step * STAGES + i;
            double *to = states + (at + 1) * 3 * size, *V_b = s->straight;
            for (Size e = 0; e < size; e++) {
                double turned = 0;
                for (int j = 0; j < STAGES; j++)
                    turned += s->tableau->inverse[i][j] * x[j * size + e];
                to[e] = q_b[e] + h * s->tableau->c[i] * v_b[e] + h * h * x[i * size + e];
                V_b[e] = v_b[e] + h * turned;
            }
            *ends = stage_completed(s, at, to, V_b, known[1] + at * s->n_b * n,
                                    known[2] + at * s->n_b * n, to + size, to + 2 * size,
                                    lam_b + (at + 1) * s->n_b * p->n_lam);
            if (*ends)
                return step;
        }
    }
    return s->stages->k;
}

/* Transpose of `stage_completed`: from covectors on q, v and lam, nullptr for none, to those on q and
 * V in place; covectors on the right sides of v and of a are rows of `moved` and `ended`. */
int stage_completed_back(const StagePass *s, Size at, double *on_q, double *on_v,
                         const double *on_lam, double *moved, double *ended)
{
    const Plan<double> *p = s->plan;
    const ComputedStages *of = s->stages;
    const Csr<double> *K = &p->K, *B = &p->B;
    Size n_q = p->n_q, n_B = p->constraints->n_values;
    const double *rate = at_stage(of->rate, at, n_B);
    int failed = stage_mass_factorised(s, at);
    if (!failed && on_lam) {
        memset(s->side, 0, (size_t)n_q * sizeof(double));
        memcpy(s->side + n_q, on_lam, (size_t)p->n_lam * sizeof(double));
        failed = mass_solved(p, s->room, 'T', 1, s->side, ended);
        add_transposed(s, K, of->end_q + at * p->nnz, -1, ended, on_q);
        add_transposed(s, K, at_stage(of->end_v, at, p->nnz), -1, ended, on_v);
        add_transposed(s, B, at_stage(of->rate_2, at, n_B), -1, ended + n_q, on_q);
        add_transposed(s, B, rate, -2, ended + n_q, on_v);
    }
    if (failed)
        return failed;
    memcpy(s->side, on_v, (size_t)n_q * sizeof(double));
    memset(s->side + n_q, 0, (size_t)p->n_lam * sizeof(double));
    failed = mass_solved(p, s->room, 'T', 1, s->side, moved);
    add_transposed(s, K, at_stage(of->held_q, at, p->nnz), -1, moved, on_q);
    add_transposed(s, B, rate, -1, moved + n_q, on_q);
    memset(on_v, 0, (size_t)n_q * sizeof(double));
    csr_rows<double>(n_q, p->M.first, p->M.columns, p->M.values, 1, n_q, moved, s->room->work, 1,
                     n_q, on_v);
    return failed;
}

/* Take the first `count` steps of the transposed recurrence, the last of them first, and return how
 * many are left. `on` are covectors on q and v after the steps, then before them; `seeds` belong to
 * the objective, on q, v and lam of stages, or nullptr. Rows of stages are written: (mu, zeta), and
 * covectors on the right sides of v and of a. */
Size stages_pulled_back(const StagePass *s, Size count, const double *const *seeds, double *on,
                        double *mu, double *moved, double *ended, int *ends)
{
    const Plan<double> *p = s->plan;
    const ComputedStages *of = s->stages;
    Size n_q = p->n_q, n_lam = p->n_lam, n = n_q + n_lam, n_B = p->constraints->n_values;
    double *on_q = s->x, *on_v = on_q + STAGES * n_q;
    for (Size step = count - 1; step >= 0; step--) {
        double h = of->h[step];
        if (pass_singular(s, step))
            return *ends = MATRIX_SINGULAR, step + 1;
        for (int i = 0; i < STAGES; i++) {
            Size at = step * STAGES + i;
            for (int a = 0; a < 2; a++)
                for (Size e = 0; e < n_q; e++)
                    (a ? on_v : on_q)[i * n_q + e] = (seeds[a] ? seeds[a][at * n_q + e] : 0) +
                                                     (i == STAGES - 1 ? on[a * n_q + e] : 0);
            *ends = stage_completed_back(s, at, on_q + i * n_q, on_v + i * n_q,
                                         at_stage(seeds[2], at, n_lam), moved + at * n,
                                         ended + at * n);
            if (*ends)
                return step + 1;
        }
        for (int i = 0; i < STAGES; i++)
            for (Size e = 0; e < n_q; e++) {
                double turned = 0;
                for (int j = 0; j < STAGES; j++)
                    turned += s->tableau->inverse[j][i] * on_v[j * n_q + e];
                s->all[i * n_q + e] = h * h * on_q[i * n_q + e] + h * turned;
            }
        memset(s->all + STAGES * n_q, 0, (size_t)(STAGES * n_lam) * sizeof(double));
        stages_solved(s->matrix, true, STAGES * n_q, STAGES * n, 1, s->all);
        memset(on, 0, 2 * (size_t)n_q * sizeof(double));
        for (int i = 0; i < STAGES; i++) {
            Size at = step * STAGES + i;
            double *own = mu + at * n, *q = on_q + i * n_q, *v = on_v + i * n_q;
            memcpy(own, s->all + i * n_q, (size_t)n_q * sizeof(double));
            for (Size e = 0; e < n_lam; e++)
                own[n_q + e] = s->all[STAGES * n_q + i * n_lam + e] / (h * h);
            add_transposed(s, &p->K, of->f_q + at * p->nnz, -1, own, q);
            add_transposed(s, &p->B, of->Phi_q + at * n_B, -1, own + n_q, q);
            add_transposed(s, &p->K, at_stage(of->f_v, at, p->nnz), -1, own, v);
            for (Size e = 0; e < n_q; e++) {
                on[e] += q[e];
                on[n_q + e] += v[e] + h * s->tableau->c[i] * q[e];
            }
        }
    }
    return 0;
}
