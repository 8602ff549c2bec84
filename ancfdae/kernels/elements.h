/* Element forces and tangents for one scalar type.
 *
 * Y and U are relative node vectors of one element, n_y rows of d numbers. g is the packed upper
 * triangle of a symmetric n_y x n_y matrix, row by row; A is symmetric, n_g x n_g
 * (docs/theory/02-strain-energy.md). n_y and d are constants where these are called, so that the
 * compiler unrolls the loops.
 */

template <class T> struct Element {
    const T *A, *g_o, *bending; /* bending is nullptr where no element bends as cables do. */
    T tau;
};

/* g = Y U^T + U Y^T, the derivative of Y Y^T in direction U. */
template <class T> INLINE void gram(int n_y, int d, const T *Y, const T *U, T *g)
{
    for (int i = 0, k = 0; i < n_y; i++)
        for (int j = i; j < n_y; j++, k++) {
            T sum = 0;
            for (int c = 0; c < d; c++)
                sum += Y[i * d + c] * U[j * d + c] + U[i * d + c] * Y[j * d + c];
            g[k] = sum;
        }
}

/* p += A x. */
template <class T> INLINE void apply(int n_g, const T *A, const T *x, T *p)
{
    for (int k = 0; k < n_g; k++)
        for (int l = 0; l < n_g; l++)
            p[l] += A[k * n_g + l] * x[k];
}

/* F += W(p) Y: the gradient of p . g(Y). */
template <class T> INLINE void stressed(int n_y, int d, const T *p, const T *Y, T *F)
{
    T W[MOST_Y * MOST_Y];
    for (int i = 0; i < n_y; i++)
        for (int j = i; j < n_y; j++, p++)
            W[i * n_y + j] = W[j * n_y + i] = (i == j ? 2 : 1) * *p;
    for (int i = 0; i < n_y; i++) {
        T sum[4] = {0, 0, 0, 0};
        for (int j = 0; j < n_y; j++) {
            T w = W[i * n_y + j];
            UNROLL_NOT
            for (int c = 0; c < d; c++)
                sum[c] += w * Y[j * d + c];
        }
        for (int c = 0; c < d; c++)
            F[i * d + c] += sum[c];
    }
}

/* x = g(Y) - g_o + tau g'(Y, V), what stresses are proportional to. */
template <class T>
INLINE void strain(int n_y, int d, const T *g_o, const T *Y, T tau, const T *V, T *x)
{
    int n_g = n_y * (n_y + 1) / 2;
    T rate[MOST_G];
    gram<T>(n_y, d, Y, Y, x);
    for (int k = 0; k < n_g; k++)
        x[k] = x[k] / 2 - g_o[k];
    if (V == nullptr)
        return;
    gram<T>(n_y, d, Y, V, rate);
    for (int k = 0; k < n_g; k++)
        x[k] += tau * rate[k];
}

/* Whether the element bends as cables do. */
template <class T> INLINE int is_cable(int n_y, const Element<T> *e)
{
    return n_y > 2 && e->bending && e->bending[0] != 0;
}

/* p = dU/dg = A x, and in cables the part of bending. */
template <class T>
INLINE void stress_of(int n_y, int d, const Element<T> *e, const T *x, const T *Y, T *p)
{
    int n_g = n_y * (n_y + 1) / 2;
    for (int k = 0; k < n_g; k++)
        p[k] = 0;
    apply<T>(n_g, e->A, x, p);
    if (is_cable<T>(n_y, e)) {
        T R[9], bent[6];
        bend_rows<T>(n_y, d, Y, R);
        bend_stress<T>(e->bending, R, bent);
        bend_add<T>(n_y, bent, p);
    }
}

template <class T>
INLINE void stress(int n_y, int d, const Element<T> *e, const T *Y, const T *V, T *p)
{
    T x[MOST_G];
    strain<T>(n_y, d, e->g_o, Y, e->tau, V, x);
    stress_of<T>(n_y, d, e, x, Y, p);
}

/* F += W(p) Y (eqs. 13, 17). */
template <class T>
INLINE void force(int n_y, int d, const Element<T> *e, const T *Y, const T *V, T *F)
{
    T p[MOST_G];
    stress<T>(n_y, d, e, Y, V, p);
    stressed<T>(n_y, d, p, Y, F);
}

/* F += derivative of the force along (U, Z) of (Y, V), along g_b of g_o, and along p_b of p at
 * held Y, V and g_o: W(A x' + p_b) Y + W(p) U with x' = g'(Y, U) - g_b + tau (g'(U, V) + g'(Y, Z)).
 * Where the element follows its reference x' vanishes before A, far larger, multiplies it. */
template <class T>
INLINE void force_along(int n_y, int d, const Element<T> *e, const T *p, const T *Y, const T *V,
                        const T *U, const T *Z, const T *g_b, const T *p_b, T *F)
{
    int n_g = n_y * (n_y + 1) / 2;
    T x[MOST_G], rate[MOST_G], change[MOST_G];
    gram<T>(n_y, d, Y, U, x);
    for (int k = 0; g_b && k < n_g; k++)
        x[k] -= g_b[k];
    if (V != nullptr) {
        gram<T>(n_y, d, U, V, rate);
        for (int k = 0; k < n_g; k++)
            x[k] += e->tau * rate[k];
        gram<T>(n_y, d, Y, Z, rate);
        for (int k = 0; k < n_g; k++)
            x[k] += e->tau * rate[k];
    }
    for (int k = 0; k < n_g; k++)
        change[k] = p_b ? p_b[k] : 0;
    apply<T>(n_g, e->A, x, change);
    if (is_cable<T>(n_y, e)) {
        T R[9], S[9], bent[6];
        bend_rows<T>(n_y, d, Y, R);
        bend_rows<T>(n_y, d, U, S);
        bend_stress_along<T>(e->bending, R, S, bent);
        bend_add<T>(n_y, bent, change);
    }
    stressed<T>(n_y, d, change, Y, F);
    stressed<T>(n_y, d, p, U, F);
}

/* K^T += (G(Y)^T A G(X))^T: A g'(X, U) of each unit vector U, a row of P, times W(.) Y.
 *
 * Rows of d numbers have room for `wide`, so that they are vectors of the processor; those of Y
 * are filled with zeros.
 */
template <class T>
INLINE void add_stress_columns(int n_y, int d, int wide, const T *A, const T *X, const T *Y, T *K)
{
    int n_g = n_y * (n_y + 1) / 2;
    T P[MOST_M * MOST_G];
    for (int k = 0; k < n_y * d * n_g; k++)
        P[k] = 0;
    for (int i = 0; i < n_y; i++)
        for (int j = i; j < n_y; j++, A += n_g)
            for (int c = 0; c < d; c++) {
                T *of_i = P + (i * d + c) * n_g, *of_j = P + (j * d + c) * n_g;
                T x = (i == j ? 2 : 1) * X[j * wide + c], y = X[i * wide + c];
                for (int l = 0; l < n_g; l++)
                    of_i[l] += A[l] * x;
                if (i != j)
                    for (int l = 0; l < n_g; l++)
                        of_j[l] += A[l] * y;
            }
    for (int k = 0; k < n_y * d; k++)
        stressed<T>(n_y, wide, P + k * n_g, Y, K + k * n_y * wide);
}

/* Copy rows of d numbers, scaled, into rows of `wide`. */
template <class T> INLINE void widened(int n_y, int d, int wide, T scale, const T *Y, T *wide_Y)
{
    for (int i = 0; i < n_y; i++)
        for (int c = 0; c < wide; c++)
            wide_Y[i * wide + c] = c < d ? scale * Y[i * d + c] : 0;
}

/* A + d^2U/dg^2 of bending. */
template <class T>
INLINE void stiffness_of_cable(int n_y, int d, const Element<T> *e, const T *Y, T *A)
{
    int at[6], n_g = n_y * (n_y + 1) / 2;
    T R[9], M[6][6];
    bend_places<T>(n_y, at);
    bend_rows<T>(n_y, d, Y, R);
    bend_stiffness<T>(e->bending, R, M);
    for (int k = 0; k < n_g * n_g; k++)
        A[k] = e->A[k];
    for (int k = 0; k < 6; k++)
        for (int j = 0; j < 6; j++)
            A[at[k] * n_g + at[j]] += M[k][j];
}

/* K^T of K = W(p) (x) I_d + G(Y)^T A (G(Y) + tau G(V)) (eq. 19): m rows of n_y times `wide`. In
 * cables bending adds to A, but not to damping. */
template <class T>
INLINE void tangent(int n_y, int d, int wide, const Element<T> *e, const T *Y, const T *V, T *K)
{
    int row = n_y * wide;
    T p[MOST_G], X[MOST_WIDE], wide_Y[MOST_WIDE], A[MOST_G * MOST_G];
    int bends = is_cable<T>(n_y, e);
    for (int k = 0; k < n_y * d * row; k++)
        K[k] = 0;
    stress<T>(n_y, d, e, Y, V, p);
    for (int i = 0, k = 0; i < n_y; i++)
        for (int j = i; j < n_y; j++, k++)
            for (int c = 0; c < d; c++) {
                K[(i * d + c) * row + j * wide + c] += p[k];
                K[(j * d + c) * row + i * wide + c] += p[k];
            }
    widened<T>(n_y, d, wide, 1, Y, wide_Y);
    if (bends) {
        stiffness_of_cable<T>(n_y, d, e, Y, A);
        add_stress_columns<T>(n_y, d, wide, A, wide_Y, wide_Y, K);
        if (V == nullptr)
            return;
    }
    widened<T>(n_y, d, wide, bends ? 0 : 1, Y, X);
    for (int i = 0; V && i < n_y; i++)
        for (int c = 0; c < d; c++)
            X[i * wide + c] += e->tau * V[i * d + c];
    add_stress_columns<T>(n_y, d, wide, e->A, X, wide_Y, K);
}

/* K^T of K = tau G(Y)^T A G(Y), the derivative of the force in V. */
template <class T>
INLINE void damping_tangent(int n_y, int d, int wide, const Element<T> *e, const T *Y, T *K)
{
    T X[MOST_WIDE], wide_Y[MOST_WIDE];
    for (int k = 0; k < n_y * d * n_y * wide; k++)
        K[k] = 0;
    widened<T>(n_y, d, wide, 1, Y, wide_Y);
    widened<T>(n_y, d, wide, e->tau, Y, X);
    add_stress_columns<T>(n_y, d, wide, e->A, X, wide_Y, K);
}
