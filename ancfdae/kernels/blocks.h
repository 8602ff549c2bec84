/* Loops over the elements of a block at many instants, for one scalar type.
 *
 * A block holds n elements; A, g_o and bending are those of all, or of one where all are alike. An
 * element has n_a = n_y + 1 node vectors: n_a / 2 at each node, its position first. Relative node
 * vectors are r_2 - r_1, then the slopes as they are.
 */

typedef struct {
    npy_intp n, n_q, alike, k;
    const npy_int64 *vectors;
    const T *A, *g_o, *bending, *tau;
} NAME(block);

INLINE NAME(element) NAME(element_of)(int n_g, const NAME(block) *b, npy_intp e)
{
    npy_intp at = b->alike ? 0 : e;
    NAME(element) own = {b->A + at * n_g * n_g, b->g_o + at * n_g,
                         b->bending ? b->bending + at * 2 : NULL, b->tau ? b->tau[e] : 0};
    return own;
}

/* Y = R q of one element; R has one entry for a slope and two for r_2 - r_1. */
INLINE void NAME(gather)(int n_y, int d, const npy_int64 *vectors, const T *q, T *Y)
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
INLINE void NAME(spread)(int n_y, int d, const npy_int64 *vectors, const T *F, T *Q)
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
INLINE void NAME(spread_tangent)(int n_y, int d, int wide, const npy_int32 *index, const T *K,
                                 T *values)
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

INLINE void NAME(relative_)(int n_y, int d, const NAME(block) *b, const T *q, T *Y)
{
    for (npy_intp k = 0; k < b->k; k++)
        for (npy_intp e = 0; e < b->n; e++, Y += n_y * d)
            NAME(gather)(n_y, d, b->vectors + e * (n_y + 1), q + k * b->n_q, Y);
}

INLINE void NAME(lifted_)(int n_y, int d, const NAME(block) *b, const T *F, T *Q)
{
    for (npy_intp k = 0; k < b->k; k++)
        for (npy_intp e = 0; e < b->n; e++, F += n_y * d)
            NAME(spread)(n_y, d, b->vectors + e * (n_y + 1), F, Q + k * b->n_q);
}

/* Q += R^T of the forces. */
INLINE void NAME(forces_)(int n_y, int d, const NAME(block) *b, const T *q, const T *v, T *Q)
{
    T Y[MOST_M], V[MOST_M], F[MOST_M];
    for (npy_intp k = 0; k < b->k; k++)
        for (npy_intp e = 0; e < b->n; e++) {
            const npy_int64 *vectors = b->vectors + e * (n_y + 1);
            NAME(element) own = NAME(element_of)(n_y * (n_y + 1) / 2, b, e);
            NAME(gather)(n_y, d, vectors, q + k * b->n_q, Y);
            if (v)
                NAME(gather)(n_y, d, vectors, v + k * b->n_q, V);
            for (int i = 0; i < n_y * d; i++)
                F[i] = 0;
            NAME(force)(n_y, d, &own, Y, v ? V : NULL, F);
            NAME(spread)(n_y, d, vectors, F, Q + k * b->n_q);
        }
}

/* Q += R^T of the derivatives of the forces along k directions u and z, at k states or at one. */
INLINE void NAME(forces_along_)(int n_y, int d, const NAME(block) *b, int one, const T *q,
                                const T *v, const T *u, const T *z, T *Q)
{
    T Y[MOST_M], V[MOST_M], U[MOST_M], Z[MOST_M], F[MOST_M], p[MOST_G] = {0};
    int n_g = n_y * (n_y + 1) / 2;
    for (npy_intp e = 0; e < b->n; e++) {
        const npy_int64 *vectors = b->vectors + e * (n_y + 1);
        NAME(element) own = NAME(element_of)(n_g, b, e);
        for (npy_intp k = 0; k < b->k; k++) {
            npy_intp at = k * b->n_q;
            if (k == 0 || !one) {
                NAME(gather)(n_y, d, vectors, q + at, Y);
                if (v)
                    NAME(gather)(n_y, d, vectors, v + at, V);
                NAME(stress)(n_y, d, &own, Y, v ? V : NULL, p);
            }
            NAME(gather)(n_y, d, vectors, u + at, U);
            if (v)
                NAME(gather)(n_y, d, vectors, z + at, Z);
            for (int i = 0; i < n_y * d; i++)
                F[i] = 0;
            NAME(force_along)(n_y, d, &own, p, Y, v ? V : NULL, U, Z, NULL, NULL, F);
            NAME(spread)(n_y, d, vectors, F, Q + at);
        }
    }
}

/* Values of the tangent on a pattern with nnz entries; of damping, in V, where asked for. */
INLINE void NAME(tangents_)(int n_y, int d, const NAME(block) *b, const T *q, const T *v,
                            int damping, const npy_int32 *index, npy_intp nnz, T *values)
{
    T Y[MOST_M], V[MOST_M], K[MOST_M * MOST_WIDE];
    int size = (n_y + 1) * d, wide = d == 3 ? 4 : d;
    for (npy_intp k = 0; k < b->k; k++)
        for (npy_intp e = 0; e < b->n; e++) {
            const npy_int64 *vectors = b->vectors + e * (n_y + 1);
            NAME(element) own = NAME(element_of)(n_y * (n_y + 1) / 2, b, e);
            NAME(gather)(n_y, d, vectors, q + k * b->n_q, Y);
            if (v)
                NAME(gather)(n_y, d, vectors, v + k * b->n_q, V);
            if (damping)
                NAME(damping_tangent)(n_y, d, wide, &own, Y, K);
            else
                NAME(tangent)(n_y, d, wide, &own, Y, v ? V : NULL, K);
            NAME(spread_tangent)(n_y, d, wide, index + e * size * size, K, values + k * nnz);
        }
}

/* Strains where there is a g_o, else Y U^T + U Y^T, packed, of k times n sets of node vectors. */
INLINE void NAME(packed_)(int n_y, int d, const NAME(block) *b, int one, const T *Y, const T *U,
                          T *g)
{
    int n_g = n_y * (n_y + 1) / 2;
    for (npy_intp k = 0; k < b->k; k++)
        for (npy_intp e = 0; e < b->n; e++, Y += n_y * d, g += n_g) {
            const T *own = U ? U + (k * b->n + e) * n_y * d : NULL;
            if (b->g_o)
                NAME(strain)(n_y, d, b->g_o + (one ? 0 : e) * n_g, Y, b->tau ? b->tau[e] : 0, own, g);
            else
                NAME(gram)(n_y, d, Y, own, g);
        }
}

/* For real numbers one function for each size that elements have, so that its loops have constant
 * bounds. Complex numbers, whose products cost more than loops, do with one of any size, in a third
 * of the compiler's time. */
#ifdef ANY_SIZE
#define OF_SIZE(f, ...) NAME(f)(n_y, d, __VA_ARGS__);
#else
#define OF_SIZE(f, ...)                                                                            \
    switch (n_y * 10 + d) {                                                                        \
    case 73: NAME(f)(7, 3, __VA_ARGS__); break;                                                    \
    case 52: NAME(f)(5, 2, __VA_ARGS__); break;                                                    \
    case 33: NAME(f)(3, 3, __VA_ARGS__); break;                                                    \
    case 32: NAME(f)(3, 2, __VA_ARGS__); break;                                                    \
    default: NAME(f)(n_y, d, __VA_ARGS__);                                                         \
    }
#endif

CLONES static void NAME(relative)(int n_y, int d, const NAME(block) *b, const T *q, T *Y)
{
    OF_SIZE(relative_, b, q, Y)
}

CLONES static void NAME(packed)(int n_y, int d, const NAME(block) *b, int one, const T *Y,
                                const T *U, T *g)
{
    OF_SIZE(packed_, b, one, Y, U, g)
}

CLONES static void NAME(lifted)(int n_y, int d, const NAME(block) *b, const T *F, T *Q)
{
    OF_SIZE(lifted_, b, F, Q)
}

CLONES static void NAME(forces)(int n_y, int d, const NAME(block) *b, const T *q, const T *v, T *Q)
{
    OF_SIZE(forces_, b, q, v, Q)
}

CLONES static void NAME(forces_along)(int n_y, int d, const NAME(block) *b, int one, const T *q,
                                      const T *v, const T *u, const T *z, T *Q)
{
    OF_SIZE(forces_along_, b, one, q, v, u, z, Q)
}

CLONES static void NAME(tangents)(int n_y, int d, const NAME(block) *b, const T *q, const T *v,
                                  int damping, const npy_int32 *index, npy_intp nnz, T *values)
{
    OF_SIZE(tangents_, b, q, v, damping, index, nnz, values)
}

static void NAME(stressed_each)(int n_y, int d, npy_intp n, const T *p, const T *Y, T *F)
{
    for (; n > 0; n--, p += n_y * (n_y + 1) / 2, Y += n_y * d, F += n_y * d)
        NAME(stressed)(n_y, d, p, Y, F);
}
