/* Forces of a block with their total design derivatives, for one scalar type. */

/* What design variables change in the law of elements, for pairs of element and variable. Element e
 * has pairs[first[e]] to pairs[first[e + 1] - 1] in the order of their variables: one below n_stiff
 * changes A by A_b and, side by side in rest_b, g_o and bending; one above changes tau by tau_b. */
typedef struct {
    npy_intp n_stiff;
    const npy_int64 *first, *pairs, *variables;
    const T *A_b, *rest_b, *tau_b;
} NAME(law_partials);

/* Partials in the variable of a pair: g_b += that of g_o, p_b += that of the stress at held strain
 * x of Y and V. */
INLINE void NAME(add_stress_partial)(int n_y, int d, const NAME(element) *e,
                                     const NAME(law_partials) *of, npy_int64 pair, const T *x,
                                     const T *Y, const T *V, T *g_b, T *p_b)
{
    int n_g = n_y * (n_y + 1) / 2;
    T rate[MOST_G];
    if (pair < of->n_stiff) {
        const T *rest_b = of->rest_b + pair * (n_g + 2);
        for (int k = 0; k < n_g; k++)
            g_b[k] += rest_b[k];
        if (NAME(is_cable)(n_y, e)) {
            T R[9], bent[6];
            NAME(bend_rows)(n_y, d, Y, R);
            NAME(bend_stress_partial)(e->bending, rest_b + n_g, R, bent);
            NAME(bend_add)(n_y, bent, p_b);
        }
        NAME(apply)(n_g, of->A_b + pair * n_g * n_g, x, p_b);
        return;
    }
    NAME(gram)(n_y, d, Y, V, rate);
    for (int k = 0; k < n_g; k++)
        rate[k] *= of->tau_b[pair - of->n_stiff];
    NAME(apply)(n_g, e->A, rate, p_b);
}

/* p = A_b x - c_b: the partial of the stress in the variable of a pair at held Y and V. */
INLINE void NAME(stress_partial)(int n_y, int d, const NAME(element) *e,
                                 const NAME(law_partials) *of, npy_int64 pair, const T *x,
                                 const T *Y, const T *V, T *p)
{
    int n_g = n_y * (n_y + 1) / 2, moved = 0;
    T g_b[MOST_G];
    for (int k = 0; k < n_g; k++)
        g_b[k] = p[k] = 0;
    NAME(add_stress_partial)(n_y, d, e, of, pair, x, Y, V, g_b, p);
    for (int k = 0; k < n_g; k++) {
        moved |= g_b[k] != 0;
        g_b[k] = -g_b[k];
    }
    if (moved)
        NAME(apply)(n_g, e->A, g_b, p);
}

/* Partials of R^T of the forces at rows of q and v, with these held: added to rows of Q, (k, n_b,
 * n_q), or where there are rows mu the sums over instants of their products with mu to n_b
 * numbers. */
INLINE void NAME(force_partials_)(int n_y, int d, const NAME(block) *b,
                                  const NAME(law_partials) *of, npy_intp n_b, const T *q,
                                  const T *v, const T *mu, T *Q)
{
    T Y[MOST_M], V[MOST_M], U[MOST_M], F[MOST_M], x[MOST_G], p[MOST_G], g[MOST_G];
    int n_g = n_y * (n_y + 1) / 2;
    for (npy_intp e = 0; e < b->n; e++) {
        const npy_int64 *vectors = b->vectors + e * (n_y + 1);
        NAME(element) own = NAME(element_of)(n_g, b, e);
        for (npy_intp k = 0; k < b->k && of->first[e] < of->first[e + 1]; k++) {
            NAME(gather)(n_y, d, vectors, q + k * b->n_q, Y);
            if (v)
                NAME(gather)(n_y, d, vectors, v + k * b->n_q, V);
            NAME(strain)(n_y, d, own.g_o, Y, own.tau, v ? V : NULL, x);
            if (mu) {
                NAME(gather)(n_y, d, vectors, mu + k * b->n_q, U);
                NAME(gram)(n_y, d, Y, U, g);
            }
            for (npy_int64 at = of->first[e]; at < of->first[e + 1]; at++) {
                npy_int64 i = of->variables[at];
                NAME(stress_partial)(n_y, d, &own, of, of->pairs[at], x, Y, V, p);
                for (int c = 0; mu && c < n_g; c++)
                    Q[i] += p[c] * g[c];
                if (mu)
                    continue;
                for (int c = 0; c < n_y * d; c++)
                    F[c] = 0;
                NAME(stressed)(n_y, d, p, Y, F);
                NAME(spread)(n_y, d, vectors, F, Q + (k * n_b + i) * b->n_q);
            }
        }
    }
}

CLONES static void NAME(force_partials)(int n_y, int d, const NAME(block) *b,
                                        const NAME(law_partials) *of, npy_intp n_b, const T *q,
                                        const T *v, const T *mu, T *Q)
{
    OF_SIZE(force_partials_, b, of, n_b, q, v, mu, Q)
}

/* Rows of Q += R^T of the forces at the first row of q and v, then of their total derivatives in
 * the variables, along the further rows. */
INLINE void NAME(force_totals_)(int n_y, int d, const NAME(block) *b, const NAME(law_partials) *of,
                                const T *q, const T *v, T *Q)
{
    T Y[MOST_M], V[MOST_M], U[MOST_M], Z[MOST_M], F[MOST_M], x[MOST_G], p[MOST_G];
    T g_b[MOST_G], p_b[MOST_G];
    int n_g = n_y * (n_y + 1) / 2;
    for (npy_intp e = 0; e < b->n; e++) {
        const npy_int64 *vectors = b->vectors + e * (n_y + 1);
        NAME(element) own = NAME(element_of)(n_g, b, e);
        npy_int64 at = of->first[e];
        NAME(gather)(n_y, d, vectors, q, Y);
        if (v)
            NAME(gather)(n_y, d, vectors, v, V);
        NAME(strain)(n_y, d, own.g_o, Y, own.tau, v ? V : NULL, x);
        NAME(stress_of)(n_y, d, &own, x, Y, p);
        for (int i = 0; i < n_y * d; i++)
            F[i] = 0;
        NAME(stressed)(n_y, d, p, Y, F);
        NAME(spread)(n_y, d, vectors, F, Q);
        for (npy_intp k = 1; k < b->k; k++) {
            NAME(gather)(n_y, d, vectors, q + k * b->n_q, U);
            if (v)
                NAME(gather)(n_y, d, vectors, v + k * b->n_q, Z);
            for (int i = 0; i < n_g; i++)
                g_b[i] = p_b[i] = 0;
            for (; at < of->first[e + 1] && of->variables[at] == k - 1; at++)
                NAME(add_stress_partial)(n_y, d, &own, of, of->pairs[at], x, Y, V, g_b, p_b);
            for (int i = 0; i < n_y * d; i++)
                F[i] = 0;
            NAME(force_along)(n_y, d, &own, p, Y, v ? V : NULL, U, Z, g_b, p_b, F);
            NAME(spread)(n_y, d, vectors, F, Q + k * b->n_q);
        }
    }
}

CLONES static void NAME(force_totals)(int n_y, int d, const NAME(block) *b,
                                      const NAME(law_partials) *of, const T *q, const T *v, T *Q)
{
    OF_SIZE(force_totals_, b, of, q, v, Q)
}
