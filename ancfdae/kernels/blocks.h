/* Loops over the elements of a block at many instants, for one scalar type.
 *
 * A block holds n elements; A, g_o and bending are those of all, or of one where all are alike. An
 * element has n_a = n_y + 1 node vectors: n_a / 2 at each node, its position first. Relative node
 * vectors are r_2 - r_1, then the slopes as they are.
 */

template <class T> struct Block {
    Size n, n_q, alike, k;
    const int64_t *vectors;
    const T *A, *g_o, *bending, *tau;
};

template <class T> INLINE Element<T> element_of(int n_g, const Block<T> *b, Size e)
{
    Size at = b->alike ? 0 : e;
    Element<T> own = {b->A + at * n_g * n_g, b->g_o + at * n_g,
                      b->bending ? b->bending + at * 2 : nullptr, b->tau ? b->tau[e] : 0};
    return own;
}

/* Y = R q of one element; R has one entry for a slope and two for r_2 - r_1. */
template <class T> INLINE void gather(int n_y, int d, const int64_t *vectors, const T *q, T *Y)
{
    int n_s = (n_y + 1) / 2;
    for (int c = 0; c < d; c++)
        Y[c] = q[vectors[n_s] * d + c] - q[vectors[0] * d + c];
    for (int a = 1, m = 1; a <= n_y; a++)
        if (a != n_s) {
            for (int c = 0; c < d; c++)
                Y[m * d + c] = q[vectors[a] * d + c];
            m++;
        }
}

/* Q += R^T F of one element. */
template <class T> INLINE void spread(int n_y, int d, const int64_t *vectors, const T *F, T *Q)
{
    int n_s = (n_y + 1) / 2;
    for (int c = 0; c < d; c++) {
        Q[vectors[n_s] * d + c] += F[c];
        Q[vectors[0] * d + c] -= F[c];
    }
    for (int a = 1, m = 1; a <= n_y; a++)
        if (a != n_s) {
            for (int c = 0; c < d; c++)
                Q[vectors[a] * d + c] += F[m * d + c];
            m++;
        }
}

/* values[index] += R^T K R of one element, from K^T with rows of `wide` numbers; index holds the
 * places of its (n_a d)^2 entries. */
template <class T>
INLINE void spread_tangent(int n_y, int d, int wide, const int32_t *index, const T *K, T *values)
{
    int n_a = n_y + 1, n_s = n_a / 2;
    for (int a = 0; a < n_a; a++) {
        int row = a == 0 || a == n_s ? 0 : a < n_s ? a : a - 1;
        for (int i = 0; i < d; i++)
            for (int b = 0; b < n_a; b++) {
                int column = b == 0 || b == n_s ? 0 : b < n_s ? b : b - 1;
                T sign = (a == 0) != (b == 0) ? -1 : 1;
                const T *from = K + (column * d * n_y + row) * wide + i;
                for (int j = 0; j < d; j++, index++)
                    values[*index] += sign * from[j * n_y * wide];
            }
    }
}

template <class T> INLINE void relative_(int n_y, int d, const Block<T> *b, const T *q, T *Y)
{
    for (Size k = 0; k < b->k; k++)
        for (Size e = 0; e < b->n; e++, Y += n_y * d)
            gather<T>(n_y, d, b->vectors + e * (n_y + 1), q + k * b->n_q, Y);
}

template <class T> INLINE void lifted_(int n_y, int d, const Block<T> *b, const T *F, T *Q)
{
    for (Size k = 0; k < b->k; k++)
        for (Size e = 0; e < b->n; e++, F += n_y * d)
            spread<T>(n_y, d, b->vectors + e * (n_y + 1), F, Q + k * b->n_q);
}

/* Q += R^T of the forces. */
template <class T>
INLINE void forces_(int n_y, int d, const Block<T> *b, const T *q, const T *v, T *Q)
{
    T Y[MOST_M], V[MOST_M], F[MOST_M];
    for (Size k = 0; k < b->k; k++)
        for (Size e = 0; e < b->n; e++) {
            const int64_t *vectors = b->vectors + e * (n_y + 1);
            Element<T> own = element_of<T>(n_y * (n_y + 1) / 2, b, e);
            gather<T>(n_y, d, vectors, q + k * b->n_q, Y);
            if (v)
                gather<T>(n_y, d, vectors, v + k * b->n_q, V);
            for (int i = 0; i < n_y * d; i++)
                F[i] = 0;
            force<T>(n_y, d, &own, Y, v ? V : nullptr, F);
            spread<T>(n_y, d, vectors, F, Q + k * b->n_q);
        }
}

/* Q += R^T of the derivatives of the forces along k directions u and z, at k states or at one. */
template <class T>
INLINE void forces_along_(int n_y, int d, const Block<T> *b, int one, const T *q, const T *v,
                          const T *u, const T *z, T *Q)
{
    T Y[MOST_M], V[MOST_M], U[MOST_M], Z[MOST_M], F[MOST_M], p[MOST_G] = {0};
    int n_g = n_y * (n_y + 1) / 2;
    for (Size e = 0; e < b->n; e++) {
        const int64_t *vectors = b->vectors + e * (n_y + 1);
        Element<T> own = element_of<T>(n_g, b, e);
        for (Size k = 0; k < b->k; k++) {
            Size at = k * b->n_q;
            if (k == 0 || !one) {
                gather<T>(n_y, d, vectors, q + at, Y);
                if (v)
                    gather<T>(n_y, d, vectors, v + at, V);
                stress<T>(n_y, d, &own, Y, v ? V : nullptr, p);
            }
            gather<T>(n_y, d, vectors, u + at, U);
            if (v)
                gather<T>(n_y, d, vectors, z + at, Z);
            for (int i = 0; i < n_y * d; i++)
                F[i] = 0;
            force_along<T>(n_y, d, &own, p, Y, v ? V : nullptr, U, Z, nullptr, nullptr, F);
            spread<T>(n_y, d, vectors, F, Q + at);
        }
    }
}

/* Values of the tangent on a pattern with nnz entries; of damping, in V, where asked for. */
template <class T>
INLINE void tangents_(int n_y, int d, const Block<T> *b, const T *q, const T *v, int damping,
                      const int32_t *index, Size nnz, T *values)
{
    T Y[MOST_M], V[MOST_M], K[MOST_M * MOST_WIDE];
    int size = (n_y + 1) * d, wide = d == 3 ? 4 : d;
    for (Size k = 0; k < b->k; k++)
        for (Size e = 0; e < b->n; e++) {
            const int64_t *vectors = b->vectors + e * (n_y + 1);
            Element<T> own = element_of<T>(n_y * (n_y + 1) / 2, b, e);
            gather<T>(n_y, d, vectors, q + k * b->n_q, Y);
            if (v)
                gather<T>(n_y, d, vectors, v + k * b->n_q, V);
            if (damping)
                damping_tangent<T>(n_y, d, wide, &own, Y, K);
            else
                tangent<T>(n_y, d, wide, &own, Y, v ? V : nullptr, K);
            spread_tangent<T>(n_y, d, wide, index + e * size * size, K, values + k * nnz);
        }
}

/* Strains where there is a g_o, else Y U^T + U Y^T, packed, of k times n sets of node vectors. */
template <class T>
INLINE void packed_(int n_y, int d, const Block<T> *b, int one, const T *Y, const T *U, T *g)
{
    int n_g = n_y * (n_y + 1) / 2;
    for (Size k = 0; k < b->k; k++)
        for (Size e = 0; e < b->n; e++, Y += n_y * d, g += n_g) {
            const T *own = U ? U + (k * b->n + e) * n_y * d : nullptr;
            if (b->g_o)
                strain<T>(n_y, d, b->g_o + (one ? 0 : e) * n_g, Y, b->tau ? b->tau[e] : 0, own, g);
            else
                gram<T>(n_y, d, Y, own, g);
        }
}

template <class T> void relative(int n_y, int d, const Block<T> *b, const T *q, T *Y)
{
    each_size<T>(n_y, d, [=](int n_y, int d) ALWAYS { relative_<T>(n_y, d, b, q, Y); });
}

template <class T>
void packed(int n_y, int d, const Block<T> *b, int one, const T *Y, const T *U, T *g)
{
    each_size<T>(n_y, d, [=](int n_y, int d) ALWAYS { packed_<T>(n_y, d, b, one, Y, U, g); });
}

template <class T> void lifted(int n_y, int d, const Block<T> *b, const T *F, T *Q)
{
    each_size<T>(n_y, d, [=](int n_y, int d) ALWAYS { lifted_<T>(n_y, d, b, F, Q); });
}

template <class T> void forces(int n_y, int d, const Block<T> *b, const T *q, const T *v, T *Q)
{
    each_size<T>(n_y, d, [=](int n_y, int d) ALWAYS { forces_<T>(n_y, d, b, q, v, Q); });
}

template <class T>
void forces_along(int n_y, int d, const Block<T> *b, int one, const T *q, const T *v, const T *u,
                  const T *z, T *Q)
{
    each_size<T>(n_y, d,
                 [=](int n_y, int d) ALWAYS { forces_along_<T>(n_y, d, b, one, q, v, u, z, Q); });
}

template <class T>
void tangents(int n_y, int d, const Block<T> *b, const T *q, const T *v, int damping,
              const int32_t *index, Size nnz, T *values)
{
    each_size<T>(n_y, d, [=](int n_y, int d) ALWAYS {
        tangents_<T>(n_y, d, b, q, v, damping, index, nnz, values);
    });
}

template <class T> void stressed_each(int n_y, int d, Size n, const T *p, const T *Y, T *F)
{
    for (; n > 0; n--, p += n_y * (n_y + 1) / 2, Y += n_y * d, F += n_y * d)
        stressed<T>(n_y, d, p, Y, F);
}
