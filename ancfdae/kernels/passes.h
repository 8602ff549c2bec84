/* Derivative recurrences of HHT-I3 over computed steps (docs/theory, passes), in real numbers.
 *
 * `integrators/hht/linear_passes.py` says what they are. Each step is linearised at the state that
 * it arrived at: rows of q, v and lam, and the factors of joints and of loads at its instant; or
 * values of M, one row where it is constant, f_q, f_v and Phi_q are given.
 *
 * Over a step that is `small` constraints take Phi_q dq_b + G q_b + g for their total derivative,
 * with rows of G and g, and dq_b = h (v~_b + k (v~_b - v_b)), k = (gamma - 1/2 - beta)/(1 - gamma).
 */

struct ComputedSteps {
    Size k;
    const double *h, *q, *v, *lam, *of_joints, *of_loads, *matrices;
    const double *M, *f_q, *f_v, *Phi_q; /* nullptr where steps are linearised here */
    Size rows_of_M;
    const int32_t *small; /* nullptr where none is */
    const double *G, *g;
};

/* Rows of `m`, 6 x 4, times four rows z: three of them to `after`, and three to `ahead`, which may be
 * rows of z. */
void recombined(const double *m, const double *z, Size size, double *after, double *ahead)
{
    enum { BLOCK = 64, ROWS = 6, FROM = 4 };
    double *to[] = {after, ahead};
    for (Size at = 0; at < size; at += BLOCK) {
        int count = size - at < BLOCK ? (int)(size - at) : BLOCK;
        double own[FROM][BLOCK];
        for (int j = 0; j < FROM; j++)
            memcpy(own[j], z + j * size + at, (size_t)count * sizeof(double));
        for (int i = 0; i < ROWS; i++) {
            double *row = to[i / 3] + i % 3 * size + at;
            const double *c = m + i * FROM;
            for (int k = 0; k < count; k++)
                row[k] = c[0] * own[0][k] + c[1] * own[1][k] + c[2] * own[2][k] + c[3] * own[3][k];
        }
    }
}

/* Factorise eq. (6) of step i; f_q, f_v and Phi_q, linearised at its state, stay in the room. */
int step_factorised(const Plan<double> *p, Room<double> *r, const ComputedSteps *s, Size i,
                    StepCoefficients *c)
{
    size_t of_K = (size_t)p->nnz * sizeof(double);
    *c = coefficients_of_step(s->h[i], p->rules.alpha);
    r->exchanging = 0;
    if (s->M) {
        Size n_B = p->constraints->n_values;
        memcpy(r->mass, s->M + (s->rows_of_M > 1 ? i * p->nnz : 0), of_K);
        memcpy(r->f_q, s->f_q + i * p->nnz, of_K);
        if (s->f_v)
            memcpy(r->f_v, s->f_v + i * p->nnz, of_K);
        memcpy(r->B, s->Phi_q + i * n_B, (size_t)n_B * sizeof(double));
        return factor_sum(p, r, c, r->f_q, s->f_v ? r->f_v : nullptr, r->B);
    }
    memcpy(r->q, s->q + i * p->n_q, (size_t)p->n_q * sizeof(double));
    memcpy(r->v, s->v + i * p->n_q, (size_t)p->n_q * sizeof(double));
    memcpy(r->lam, s->lam + i * p->n_lam, (size_t)p->n_lam * sizeof(double));
    at_instant<double>(p, r, s->of_joints + (p->still ? 0 : i * p->constraints->n_parts), 0, 0,
                       r->c);
    jacobian_at<double>(p, r, r->c, r->q);
    return factorised(p, r, c, s->of_loads + i * p->n_factors);
}

/* What v_b and v~_b give to dq_b of a small step. */
void parts_of_increment(const StepCoefficients *c, double *of_v, double *of_predicted)
{
    double k = (c->gamma - 0.5 - c->beta) / (1 - c->gamma);
    *of_v = -c->h * k, *of_predicted = c->h * (1 + k);
}

/* The right side of the constraints of a small step, from q_b and v_b before it and v~_b. */
void small_side(const Plan<double> *p, Room<double> *r, const ComputedSteps *s, Size i,
                const StepCoefficients *c, Size n_b, const double *before, const double *v_p,
                double *right)
{
    Size n_q = p->n_q, n_lam = p->n_lam, n = n_q + n_lam, n_B = p->constraints->n_values;
    const Csr<double> *B = &p->B;
    double of_v, of_predicted;
    parts_of_increment(c, &of_v, &of_predicted);
    for (Size b = 0; b < n_b; b++, right += n) {
        const double *q_b = before + b * n_q, *v_b = q_b + n_b * n_q;
        for (Size e = 0; e < n_q; e++)
            r->force[e] = of_predicted * v_p[b * n_q + e] + of_v * v_b[e];
        for (Size e = 0; e < n_lam; e++)
            right[n_q + e] = -s->g[(i * n_lam + e) * n_b + b] / c->in_q;
        csr_rows<double>(n_lam, B->first, B->columns, r->B, 1, n_q, r->force, r->work,
                         -1 / c->in_q, n, right + n_q);
        csr_rows<double>(n_lam, B->first, B->columns, s->G + i * n_B, 1, n_q, q_b, r->work,
                         -1 / c->in_q, n, right + n_q);
    }
}

/* Take steps of direct differentiation from a first one on, as many as are factorised, and return the
 * number of the next: z are q~_b, v~_b, A~_b and a_b, n_b rows each; `right` are what is known of the
 * right sides, and overwritten; x has room for one. States begin with those before step 0. */
Size differentiated(const Plan<double> *p, Room<double> *r, const ComputedSteps *s, Size first,
                    Size n_b, double *right, double *z, double *states, double *lam_b, double *x,
                    int *ends)
{
    Size n_q = p->n_q, n_lam = p->n_lam, n = n_q + n_lam, size = n_b * n_q;
    const Csr<double> *K = &p->K, *B = &p->B, *M = &p->M;
    for (Size i = first; i < s->k; i++) {
        StepCoefficients c;
        double *own = right + i * n_b * n;
        if ((*ends = step_factorised(p, r, s, i, &c)))
            return i;
        csr_rows<double>(n_q, K->first, K->columns, r->f_q, n_b, n_q, z, r->work, -1, n, own);
        if (s->small && s->small[i])
            small_side(p, r, s, i, &c, n_b, states + i * 3 * size, z + size, own);
        else
            csr_rows<double>(n_lam, B->first, B->columns, r->B, n_b, n_q, z, r->work, -1 / c.in_q,
                             n, own + n_q);
        csr_rows<double>(n_q, M->first, M->columns, M->values, n_b, n_q, z + 2 * size, r->work, -1,
                         n, own);
        if (p->velocity)
            csr_rows<double>(n_q, K->first, K->columns, r->f_v, n_b, n_q, z + size, r->work, -1, n,
                             own);
        if ((*ends = solved_rows(p, r, &c, 'N', TO_ROUND_OFF, n_b, own, x)))
            return i;
        for (Size b = 0; b < n_b; b++) {
            memcpy(z + 3 * size + b * n_q, x + b * n, (size_t)n_q * sizeof(double));
            memcpy(lam_b + (i * n_b + b) * n_lam, x + b * n + n_q, (size_t)n_lam * sizeof(double));
        }
        recombined(s->matrices + i * 24, z, size, states + (i + 1) * 3 * size, z);
    }
    return s->k;
}

/* Take the first `count` steps of the transposed recurrence, the last of them first, and return how
 * many are left: `on` are covectors on (q_b, v_b,
 * A_b) and the next (q~_b, v~_b, A~_b), `seeds` those of the objective on q, v and lam or nullptr. mu
 * and zeta are rows for each step, and so are, unless nullptr, covectors on the defects of q, v and
 * A. The part of g in the gradient is left to who has it: zeta g of small steps. */
Size pulled_back(const Plan<double> *p, Room<double> *r, const ComputedSteps *s, Size count,
                 const double *const *seeds, double *on, double *mu, double *zeta,
                 double *on_defects, int *ends)
{
    Size n_q = p->n_q, n_lam = p->n_lam, n_B = p->constraints->n_values;
    const Csr<double> *K = &p->K, *B = &p->B, *M = &p->M;
    double *to[] = {r->q, r->v, r->A, r->R};
    for (Size i = count - 1; i >= 0; i--) {
        StepCoefficients c;
        const double *m = s->matrices + i * 24;
        if ((*ends = step_factorised(p, r, s, i, &c)))
            return i + 1;
        for (Size e = 0; e < n_q; e++) {
            double own[6];
            for (int a = 0; a < 6; a++)
                own[a] = on[a * n_q + e] + (a < 2 && seeds[a] ? seeds[a][i * n_q + e] : 0);
            for (int b = 0; b < 4; b++) {
                to[b][e] = 0;
                for (int a = 0; a < 6; a++)
                    to[b][e] += m[a * 4 + b] * own[a];
            }
        }
        for (Size e = 0; e < n_lam; e++)
            r->R[n_q + e] = seeds[2] ? seeds[2][i * n_lam + e] : 0;
        if ((*ends = solved_rows(p, r, &c, 'T', TO_ROUND_OFF, 1, r->R, r->x)))
            return i + 1;
        int small = s->small && s->small[i];
        double of_B = -1 / c.in_q, of_v = 0, of_predicted = 0;
        if (r->factored == BY_ENVELOPE || r->factored == BY_FRONTS) /* What has them is symmetric. */
            csr_rows<double>(n_q, K->first, K->columns, r->f_q, 1, n_q, r->x, r->work, -1, n_q,
                             r->q);
        else
            csr_rows_transposed<double>(n_q, K->first, K->columns, r->f_q, 1, r->x, -1, n_q, r->q);
        if (p->velocity)
            csr_rows_transposed<double>(n_q, K->first, K->columns, r->f_v, 1, r->x, -1, n_q, r->v);
        csr_rows<double>(n_q, M->first, M->columns, M->values, 1, n_q, r->x, r->work, -1, n_q,
                         r->A);
        /* On q~_b, or over a small step on dq_b and on q_b before it. */
        memset(on, 0, 3 * (size_t)n_q * sizeof(double));
        memset(r->force, 0, (size_t)n_q * sizeof(double));
        csr_rows_transposed<double>(n_lam, B->first, B->columns, r->B, 1, r->x + n_q, of_B, n_q,
                                    small ? r->force : r->q);
        for (int a = 0; a < 3; a++)
            for (Size e = 0; on_defects && e < n_q; e++)
                on_defects[(i * 3 + a) * n_q + e] = to[a][e] + (a ? 0 : r->force[e]);
        if (small) {
            csr_rows_transposed<double>(n_lam, B->first, B->columns, s->G + i * n_B, 1, r->x + n_q,
                                        of_B, n_q, on);
            parts_of_increment(&c, &of_v, &of_predicted);
            for (Size e = 0; e < n_q; e++) {
                on[n_q + e] = of_v * r->force[e];
                r->v[e] += of_predicted * r->force[e];
            }
        }
        memcpy(mu + i * n_q, r->x, (size_t)n_q * sizeof(double));
        for (Size e = 0; e < n_lam; e++)
            zeta[i * n_lam + e] = r->x[n_q + e] / c.in_q;
        for (int a = 0; a < 3; a++)
            memcpy(on + (3 + a) * n_q, to[a], (size_t)n_q * sizeof(double));
    }
    return 0;
}
