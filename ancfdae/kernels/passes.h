/* Derivative recurrences of HHT-I3 over computed steps (docs/theory, passes), in real numbers.
 *
 * `integrators/hht/linear_passes.py` says what they are. Each step is linearised at the state that
 * it arrived at: rows of q, v and lam, and the factors of joints and of loads at its instant.
 */

struct ComputedSteps {
    Size k;
    const double *h, *q, *v, *lam, *of_joints, *of_loads, *matrices;
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
    *c = coefficients_of_step(s->h[i], p->rules.alpha);
    memcpy(r->q, s->q + i * p->n_q, (size_t)p->n_q * sizeof(double));
    memcpy(r->v, s->v + i * p->n_q, (size_t)p->n_q * sizeof(double));
    memcpy(r->lam, s->lam + i * p->n_lam, (size_t)p->n_lam * sizeof(double));
    at_instant<double>(p, r, s->of_joints + (p->still ? 0 : i * p->constraints->n_parts), 0, 0,
                       r->c);
    jacobian_at<double>(p, r, r->c, r->q);
    return factorised<double>(p, r, c, s->of_loads + i * p->n_factors);
}

/* Take steps of direct differentiation, as many as are factorised: z are q~_b, v~_b, A~_b and a_b, n_b
 * rows each; `right` are what is known of the right sides, and overwritten; x has room for one. */
Size differentiated(const Plan<double> *p, Room<double> *r, const ComputedSteps *s, Size n_b,
                    double *right, double *z, double *states, double *lam_b, double *x, int *ends)
{
    Size n_q = p->n_q, n_lam = p->n_lam, n = n_q + n_lam, size = n_b * n_q;
    const Csr<double> *K = &p->K, *B = &p->B, *M = &p->M;
    for (Size i = 0; i < s->k; i++, right += n_b * n) {
        StepCoefficients c;
        if ((*ends = step_factorised(p, r, s, i, &c)))
            return i;
        csr_rows<double>(n_q, K->first, K->columns, r->f_q, n_b, n_q, z, r->work, -1, n, right);
        csr_rows<double>(n_lam, B->first, B->columns, r->B, n_b, n_q, z, r->work, -1 / c.in_q, n,
                         right + n_q);
        csr_rows<double>(n_q, M->first, M->columns, M->values, n_b, n_q, z + 2 * size, r->work, -1,
                         n, right);
        if (p->velocity)
            csr_rows<double>(n_q, K->first, K->columns, r->f_v, n_b, n_q, z + size, r->work, -1, n,
                             right);
        if ((*ends = solve_rows<double>(p, r, 'N', TO_ROUND_OFF, n_b, right, x)))
            return i;
        for (Size b = 0; b < n_b; b++) {
            memcpy(z + 3 * size + b * n_q, x + b * n, (size_t)n_q * sizeof(double));
            memcpy(lam_b + (i * n_b + b) * n_lam, x + b * n + n_q, (size_t)n_lam * sizeof(double));
        }
        recombined(s->matrices + i * 24, z, size, states + i * 3 * size, z);
    }
    return s->k;
}

/* Take steps of the transposed recurrence back from the last one: `on` are covectors on (q_b, v_b,
 * A_b) and the next (q~_b, v~_b, A~_b), `seeds` those of the objective on q, v and lam or nullptr. mu
 * and zeta are rows for each step. */
Size pulled_back(const Plan<double> *p, Room<double> *r, const ComputedSteps *s,
                 const double *const *seeds, double *on, double *mu, double *zeta, int *ends)
{
    Size n_q = p->n_q, n_lam = p->n_lam;
    const Csr<double> *K = &p->K, *B = &p->B, *M = &p->M;
    double *to[] = {r->q, r->v, r->A, r->R};
    for (Size i = s->k - 1; i >= 0; i--) {
        StepCoefficients c;
        const double *m = s->matrices + i * 24;
        if ((*ends = step_factorised(p, r, s, i, &c)))
            return s->k - 1 - i;
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
        if ((*ends = solve_rows<double>(p, r, 'T', TO_ROUND_OFF, 1, r->R, r->x)))
            return s->k - 1 - i;
        if (r->factored == BY_BAND)
            csr_rows_transposed<double>(n_q, K->first, K->columns, r->f_q, 1, r->x, -1, n_q, r->q);
        else /* What has an envelope or fronts is symmetric. */
            csr_rows<double>(n_q, K->first, K->columns, r->f_q, 1, n_q, r->x, r->work, -1, n_q,
                             r->q);
        csr_rows_transposed<double>(n_lam, B->first, B->columns, r->B, 1, r->x + n_q, -1 / c.in_q,
                                    n_q, r->q);
        if (p->velocity)
            csr_rows_transposed<double>(n_q, K->first, K->columns, r->f_v, 1, r->x, -1, n_q, r->v);
        csr_rows<double>(n_q, M->first, M->columns, M->values, 1, n_q, r->x, r->work, -1, n_q,
                         r->A);
        memcpy(mu + i * n_q, r->x, (size_t)n_q * sizeof(double));
        for (Size e = 0; e < n_lam; e++)
            zeta[i * n_lam + e] = r->x[n_q + e] / c.in_q;
        memset(on, 0, 3 * (size_t)n_q * sizeof(double));
        for (int a = 0; a < 3; a++)
            memcpy(on + (3 + a) * n_q, to[a], (size_t)n_q * sizeof(double));
    }
    return s->k;
}
