/* Derivative recurrences of HHT-I3 over computed steps (docs/theory, passes), in real numbers.
 *
 * `integrators/hht/linear_passes.py` says what they are. Steps are linearised before: values of
 * f_q, f_v (NULL where f does not depend on v) and Phi_q, one row for each step.
 */

typedef struct {
    npy_intp k;
    const double *h, *f_q, *f_v, *Phi_q, *matrices;
} linear_steps;

/* Rows of `m`, 6 x 4, times four rows z: three of them to `after`, and three to `ahead`, which may be
 * rows of z. */
static void recombined(const double *m, const double *z, npy_intp size, double *after,
                       double *ahead)
{
    enum { BLOCK = 64, ROWS = 6, FROM = 4 };
    double *to[] = {after, ahead};
    for (npy_intp at = 0; at < size; at += BLOCK) {
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

/* Factorise eq. (6) of step i, with its coefficients. */
static int step_factorised(const plan_real *p, room_real *r, const linear_steps *s, npy_intp i,
                           step_coefficients *c)
{
    *c = coefficients_of_step(s->h[i], p->rules.alpha);
    return factor_sum_real(p, r, c, s->f_q + i * p->nnz, s->f_v ? s->f_v + i * p->nnz : NULL,
                           s->Phi_q + i * p->constraints->n_values);
}

/* Take steps of direct differentiation, as many as are factorised: z are q~_b, v~_b, A~_b and a_b, n_b
 * rows each; `right` are what is known of the right sides, and overwritten; x has room for one. */
static npy_intp differentiated(const plan_real *p, room_real *r, const linear_steps *s,
                               npy_intp n_b, double *right, double *z, double *states,
                               double *lam_b, double *x, int *ends)
{
    npy_intp n_q = p->n_q, n_lam = p->n_lam, n = n_q + n_lam, size = n_b * n_q;
    const csr_real *K = &p->K, *B = &p->B, *M = &p->M;
    for (npy_intp i = 0; i < s->k; i++, right += n_b * n) {
        step_coefficients c;
        if ((*ends = step_factorised(p, r, s, i, &c)))
            return i;
        csr_rows_real(n_q, K->first, K->columns, s->f_q + i * p->nnz, n_b, n_q, z, r->work, -1, n,
                      right);
        csr_rows_real(n_lam, B->first, B->columns, s->Phi_q + i * p->constraints->n_values, n_b,
                      n_q, z, r->work, -1 / c.in_q, n, right + n_q);
        csr_rows_real(n_q, M->first, M->columns, M->values, n_b, n_q, z + 2 * size, r->work, -1, n,
                      right);
        if (s->f_v)
            csr_rows_real(n_q, K->first, K->columns, s->f_v + i * p->nnz, n_b, n_q, z + size,
                          r->work, -1, n, right);
        solve_rows_real(p, r, 'N', n_b, right, x);
        for (npy_intp b = 0; b < n_b; b++) {
            memcpy(z + 3 * size + b * n_q, x + b * n, (size_t)n_q * sizeof(double));
            memcpy(lam_b + (i * n_b + b) * n_lam, x + b * n + n_q, (size_t)n_lam * sizeof(double));
        }
        recombined(s->matrices + i * 24, z, size, states + i * 3 * size, z);
    }
    return s->k;
}

/* Take steps of the transposed recurrence back from the last one: `on` are covectors on (q_b, v_b,
 * A_b) and the next (q~_b, v~_b, A~_b), `seeds` those of the objective on q, v and lam or NULL. mu
 * and zeta are rows for each step. */
static npy_intp pulled_back(const plan_real *p, room_real *r, const linear_steps *s,
                            const double *const *seeds, double *on, double *mu, double *zeta,
                            int *ends)
{
    npy_intp n_q = p->n_q, n_lam = p->n_lam;
    const csr_real *K = &p->K, *B = &p->B, *M = &p->M;
    double *to[] = {r->q, r->v, r->A, r->R};
    for (npy_intp i = s->k - 1; i >= 0; i--) {
        step_coefficients c;
        const double *m = s->matrices + i * 24;
        if ((*ends = step_factorised(p, r, s, i, &c)))
            return s->k - 1 - i;
        for (npy_intp e = 0; e < n_q; e++) {
            double own[6];
            for (int a = 0; a < 6; a++)
                own[a] = on[a * n_q + e] + (a < 2 && seeds[a] ? seeds[a][i * n_q + e] : 0);
            for (int b = 0; b < 4; b++) {
                to[b][e] = 0;
                for (int a = 0; a < 6; a++)
                    to[b][e] += m[a * 4 + b] * own[a];
            }
        }
        for (npy_intp e = 0; e < n_lam; e++)
            r->R[n_q + e] = seeds[2] ? seeds[2][i * n_lam + e] : 0;
        solve_rows_real(p, r, 'T', 1, r->R, r->x);
        csr_rows_transposed_real(n_q, K->first, K->columns, s->f_q + i * p->nnz, 1, r->x, -1, n_q,
                                 r->q);
        csr_rows_transposed_real(n_lam, B->first, B->columns,
                                 s->Phi_q + i * p->constraints->n_values, 1, r->x + n_q,
                                 -1 / c.in_q, n_q, r->q);
        if (s->f_v)
            csr_rows_transposed_real(n_q, K->first, K->columns, s->f_v + i * p->nnz, 1, r->x, -1,
                                     n_q, r->v);
        csr_rows_transposed_real(n_q, M->first, M->columns, M->values, 1, r->x, -1, n_q, r->A);
        memcpy(mu + i * n_q, r->x, (size_t)n_q * sizeof(double));
        for (npy_intp e = 0; e < n_lam; e++)
            zeta[i * n_lam + e] = r->x[n_q + e] / c.in_q;
        memset(on, 0, 3 * (size_t)n_q * sizeof(double));
        for (int a = 0; a < 3; a++)
            memcpy(on + (3 + a) * n_q, to[a], (size_t)n_q * sizeof(double));
    }
    return s->k;
}
