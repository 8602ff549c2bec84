/* Forces of a block with their total design derivatives, for one scalar type. */

/* What design variables change in the law of elements, for pairs of element and variable. Element e
 * has pairs[first[e]] to pairs[first[e + 1] - 1] in the order of their variables: one below n_stiff
 * changes A by A_b and, side by side in rest_b, g_o and bending; one above changes tau by tau_b. */
template <class T> struct LawPartials {
    Size n_stiff;
    const int64_t *first, *pairs, *variables;
    const T *A_b, *rest_b, *tau_b;
};

/* Partials in the variable of a pair: g_b += that of g_o, p_b += that of the stress at held strain
 * x of Y and V. */
template <class T>
INLINE void add_stress_partial(int n_y, int d, const Element<T> *e, const LawPartials<T> *of,
                               int64_t pair, const T *x, const T *Y, const T *V, T *g_b, T *p_b)
{
    int n_g = n_y * (n_y + 1) / 2;
    T rate[MOST_G];
    if (pair < of->n_stiff) {
        const T *rest_b = of->rest_b + pair * (n_g + 2);
        for (int k = 0; k < n_g; k++)
            g_b[k] += rest_b[k];
        if (is_cable<T>(n_y, e)) {
            T R[9], bent[6];
            bend_rows<T>(n_y, d, Y, R);
            bend_stress_partial<T>(e->bending, rest_b + n_g, R, bent);
            bend_add<T>(n_y, bent, p_b);
        }
        apply<T>(n_g, of->A_b + pair * n_g * n_g, x, p_b);
        return;
    }
    gram<T>(n_y, d, Y, V, rate);
    for (int k = 0; k < n_g; k++)
        rate[k] *= of->tau_b[pair - of->n_stiff];
    apply<T>(n_g, e->A, rate, p_b);
}

/* p = A_b x - c_b: the partial of the stress in the variable of a pair at held Y and V. */
template <class T>
INLINE void stress_partial(int n_y, int d, const Element<T> *e, const LawPartials<T> *of,
                           int64_t pair, const T *x, const T *Y, const T *V, T *p)
{
    int n_g = n_y * (n_y + 1) / 2, moved = 0;
    T g_b[MOST_G];
    for (int k = 0; k < n_g; k++)
        g_b[k] = p[k] = 0;
    add_stress_partial<T>(n_y, d, e, of, pair, x, Y, V, g_b, p);
    for (int k = 0; k < n_g; k++) {
        moved |= g_b[k] != 0;
        g_b[k] = -g_b[k];
    }
    if (moved)
        apply<T>(n_g, e->A, g_b, p);
}

/* Partials of R^T of the forces at rows of q and v, with these held: added to rows of Q, (k, n_b,
 * n_q), or where there are rows mu the sums over instants of their products with mu to n_b
 * numbers. */
template <class T>
INLINE void force_partials_(int n_y, int d, const Block<T> *b, const LawPartials<T> *of, Size n_b,
                            const T *q, const T *v, const T *mu, T *Q)
{
    T Y[MOST_M], V[MOST_M], U[MOST_M], F[MOST_M], x[MOST_G], p[MOST_G], g[MOST_G];
    int n_g = n_y * (n_y + 1) / 2;
    for (Size e = 0; e < b->n; e++) {
        const int64_t *vectors = b->vectors + e * (n_y + 1);
        Element<T> own = element_of<T>(n_g, b, e);
        for (Size k = 0; k < b->k && of->first[e] < of->first[e + 1]; k++) {
            gather<T>(n_y, d, vectors, q + k * b->n_q, Y);
            if (v)
                gather<T>(n_y, d, vectors, v + k * b->n_q, V);
            strain<T>(n_y, d, own.g_o, Y, own.tau, v ? V : nullptr, x);
            if (mu) {
                gather<T>(n_y, d, vectors, mu + k * b->n_q, U);
                gram<T>(n_y, d, Y, U, g);
            }
            for (int64_t at = of->first[e]; at < of->first[e + 1]; at++) {
                int64_t i = of->variables[at];
                stress_partial<T>(n_y, d, &own, of, of->pairs[at], x, Y, V, p);
                for (int c = 0; mu && c < n_g; c++)
                    Q[i] += p[c] * g[c];
                if (mu)
                    continue;
                for (int c = 0; c < n_y * d; c++)
                    F[c] = 0;
                stressed<T>(n_y, d, p, Y, F);
                spread<T>(n_y, d, vectors, F, Q + (k * n_b + i) * b->n_q);
            }
        }
    }
}

template <class T>
void force_partials(int n_y, int d, const Block<T> *b, const LawPartials<T> *of, Size n_b,
                    const T *q, const T *v, const T *mu, T *Q)
{
    each_size<T>(n_y, d, [=](int n_y, int d) ALWAYS {
        force_partials_<T>(n_y, d, b, of, n_b, q, v, mu, Q);
    });
}

/* Rows of Q += R^T of the forces at the first row of q and v, then of their total derivatives in
 * the variables, along the further rows. */
template <class T>
INLINE void force_totals_(int n_y, int d, const Block<T> *b, const LawPartials<T> *of, const T *q,
                          const T *v, T *Q)
{
    T Y[MOST_M], V[MOST_M], U[MOST_M], Z[MOST_M], F[MOST_M], x[MOST_G], p[MOST_G];
    T g_b[MOST_G], p_b[MOST_G];
    int n_g = n_y * (n_y + 1) / 2;
    for (Size e = 0; e < b->n; e++) {
        const int64_t *vectors = b->vectors + e * (n_y + 1);
        Element<T> own = element_of<T>(n_g, b, e);
        int64_t at = of->first[e];
        gather<T>(n_y, d, vectors, q, Y);
        if (v)
            gather<T>(n_y, d, vectors, v, V);
        strain<T>(n_y, d, own.g_o, Y, own.tau, v ? V : nullptr, x);
        stress_of<T>(n_y, d, &own, x, Y, p);
        for (int i = 0; i < n_y * d; i++)
            F[i] = 0;
        stressed<T>(n_y, d, p, Y, F);
        spread<T>(n_y, d, vectors, F, Q);
        for (Size k = 1; k < b->k; k++) {
            gather<T>(n_y, d, vectors, q + k * b->n_q, U);
            if (v)
                gather<T>(n_y, d, vectors, v + k * b->n_q, Z);
            for (int i = 0; i < n_g; i++)
                g_b[i] = p_b[i] = 0;
            for (; at < of->first[e + 1] && of->variables[at] == k - 1; at++)
                add_stress_partial<T>(n_y, d, &own, of, of->pairs[at], x, Y, V, g_b, p_b);
            for (int i = 0; i < n_y * d; i++)
                F[i] = 0;
            force_along<T>(n_y, d, &own, p, Y, v ? V : nullptr, U, Z, g_b, p_b, F);
            spread<T>(n_y, d, vectors, F, Q + k * b->n_q);
        }
    }
}

template <class T>
void force_totals(int n_y, int d, const Block<T> *b, const LawPartials<T> *of, const T *q,
                  const T *v, T *Q)
{
    each_size<T>(n_y, d, [=](int n_y, int d) ALWAYS { force_totals_<T>(n_y, d, b, of, q, v, Q); });
}
