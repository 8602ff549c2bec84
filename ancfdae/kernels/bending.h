/* Bending of cables for one scalar type (docs/theory/02-strain-energy.md, "Bending of cables").
 *
 * U = E I/l sum_k w_k psi, psi = kappa^2/2 = (b/a - c^2/a^2)/2, at two Gauss points, with t = r_x,
 * h = l r_xx and a = t.t, b = h.h, c = t.h. These are linear in the products m of chord/l, r_x1 and
 * r_x2, packed row by row: six of them. `bending` holds E I and l; E I is zero in a beam.
 */

/* Gauss points lie 1/(2 sqrt 3) from the middle, and have the weights 1/2. */
#define BEND_AT 0.28867513459481288225
#define BEND_WEIGHT 0.5
/* Weights of the products in a, b and c; s is the side of the middle: 1 before it, -1 behind. */
#define BEND_OF(s)                                                                                 \
    {                                                                                              \
        {1, 2 * s, -2 * s, 1.0 / 12, -1.0 / 6, 1.0 / 12},                                          \
            {12, -24 * s - 12, 24 * s - 12, 4 + 12 * s, 4, 4 - 12 * s},                            \
            {12 * s, -6 * s, -6 * s, -s - 0.5, 2 * s, 0.5 - s},                                    \
    }
const double BEND[2][3][6] = {BEND_OF(BEND_AT), BEND_OF(-BEND_AT)};

/* R = chord, r_x1 and r_x2, the rows of Y that bending needs: three of 3 numbers, zero out of the
 * plane, so that the functions below have one size and stand once. */
template <class T> INLINE void bend_rows(int n_y, int d, const T *Y, T *R)
{
    const int row[] = {0, 1, (n_y + 1) / 2};
    for (int i = 0; i < 3; i++)
        for (int c = 0; c < 3; c++)
            R[i * 3 + c] = c < d ? Y[row[i] * d + c] : 0;
}

/* Where the products of those rows stand in g. */
template <class T> INLINE void bend_places(int n_y, int *at)
{
    const int row[] = {0, 1, (n_y + 1) / 2};
    for (int i = 0, k = 0; i < 3; i++)
        for (int j = i; j < 3; j++, k++)
            at[k] = row[i] * n_y - row[i] * (row[i] + 1) / 2 + row[j];
}

/* p += x, what bending adds to the stresses of products. */
template <class T> INLINE void bend_add(int n_y, const T *x, T *p)
{
    int at[6];
    bend_places<T>(n_y, at);
    for (int k = 0; k < 6; k++)
        p[at[k]] += x[k];
}

/* What scales the products: 1/l for each chord. */
template <class T> INLINE void bend_scales(T per_l, T *scale)
{
    for (int k = 0; k < 6; k++)
        scale[k] = k == 0 ? per_l * per_l : k < 3 ? per_l : 1;
}

/* m = products of rows of R and S, both ways round, times `part` and the scales. */
template <class T> INLINE void bend_products(T part, const T *scale, const T *R, const T *S, T *m)
{
    for (int i = 0, k = 0; i < 3; i++)
        for (int j = i; j < 3; j++, k++) {
            T sum = 0;
            for (int c = 0; c < 3; c++)
                sum += R[i * 3 + c] * S[j * 3 + c] + S[i * 3 + c] * R[j * 3 + c];
            m[k] = part * scale[k] * sum;
        }
}

/* a, b and c of a point, or their rates. */
template <class T> INLINE void bend_measures(int point, const T *m, T *x)
{
    for (int i = 0; i < 3; i++) {
        x[i] = 0;
        for (int k = 0; k < 6; k++)
            x[i] += BEND[point][i][k] * m[k];
    }
}

/* Second partials of psi, times the weight of the point: in aa, ab, ac, cc; others vanish. */
template <class T> INLINE void bend_curvature(const T *x, T *of)
{
    T per_a = 1 / x[0], r = x[2] * per_a, square = BEND_WEIGHT * per_a * per_a;
    of[0] = square * per_a * (x[1] - 3 * x[2] * r);
    of[1] = -0.5 * square;
    of[2] = 2 * square * r;
    of[3] = -square;
}

/* x = sum of the partials of w psi in the six products. */
template <class T> INLINE void bend_gradient(const T *m, T *x)
{
    for (int k = 0; k < 6; k++)
        x[k] = 0;
    for (int point = 0; point < 2; point++) {
        T s[3];
        bend_measures<T>(point, m, s);
        T per_a = 1 / s[0], r = s[2] * per_a, half = BEND_WEIGHT * per_a;
        T on[] = {(s[2] * r - 0.5 * s[1]) * per_a * half, 0.5 * half, -r * half};
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 6; k++)
                x[k] += on[i] * BEND[point][i][k];
    }
}

/* x = change of the gradient along the products m_u. */
template <class T> INLINE void bend_along(const T *m, const T *m_u, T *x)
{
    for (int k = 0; k < 6; k++)
        x[k] = 0;
    for (int point = 0; point < 2; point++) {
        T s[3], u[3], of[4];
        bend_measures<T>(point, m, s);
        bend_measures<T>(point, m_u, u);
        bend_curvature<T>(s, of);
        T on[] = {of[0] * u[0] + of[1] * u[1] + of[2] * u[2], of[1] * u[0],
                  of[2] * u[0] + of[3] * u[2]};
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 6; k++)
                x[k] += on[i] * BEND[point][i][k];
    }
}

/* x = dU/dg of bending in the six products. */
template <class T> void bend_stress(const T *bending, const T *R, T *x)
{
    T m[6], scale[6], per_l = 1 / bending[1];
    bend_scales<T>(per_l, scale);
    bend_products<T>(0.5, scale, R, R, m);
    bend_gradient<T>(m, x);
    for (int k = 0; k < 6; k++)
        x[k] *= bending[0] * per_l * scale[k];
}

/* x = the derivative of that along rows S. */
template <class T> void bend_stress_along(const T *bending, const T *R, const T *S, T *x)
{
    T m[6], m_u[6], scale[6], per_l = 1 / bending[1];
    bend_scales<T>(per_l, scale);
    bend_products<T>(0.5, scale, R, R, m);
    bend_products<T>(1, scale, R, S, m_u);
    bend_along<T>(m, m_u, x);
    for (int k = 0; k < 6; k++)
        x[k] *= bending[0] * per_l * scale[k];
}

/* x = its partial at held R along changes `bending_b` of E I and l. The length stands in E I/l, in
 * the scales of the products, and in the products themselves. */
template <class T> void bend_stress_partial(const T *bending, const T *bending_b, const T *R, T *x)
{
    T m[6], m_l[6], x_l[6], scale[6], per_l = 1 / bending[1], grown = bending_b[1] * per_l;
    bend_scales<T>(per_l, scale);
    bend_products<T>(0.5, scale, R, R, m);
    bend_gradient<T>(m, x);
    for (int k = 0; k < 6; k++)
        m_l[k] = k == 0 ? -2 * m[k] : k < 3 ? -m[k] : 0;
    bend_along<T>(m, m_l, x_l);
    for (int k = 0; k < 6; k++) {
        T change = bending_b[0] - bending[0] * grown * (k == 0 ? 3 : k < 3 ? 2 : 1);
        x[k] = per_l * scale[k] * (change * x[k] + bending[0] * grown * x_l[k]);
    }
}

/* M = d^2U/dg^2 in the six products. */
template <class T> void bend_stiffness(const T *bending, const T *R, T M[6][6])
{
    T m[6], scale[6], per_l = 1 / bending[1];
    bend_scales<T>(per_l, scale);
    bend_products<T>(0.5, scale, R, R, m);
    for (int k = 0; k < 6; k++)
        for (int j = 0; j < 6; j++)
            M[k][j] = 0;
    for (int point = 0; point < 2; point++) {
        T s[3], of[4];
        const double *a = BEND[point][0], *b = BEND[point][1], *c = BEND[point][2];
        bend_measures<T>(point, m, s);
        bend_curvature<T>(s, of);
        for (int k = 0; k < 6; k++) {
            T on_a = of[0] * a[k] + of[1] * b[k] + of[2] * c[k], on_b = of[1] * a[k];
            T on_c = of[2] * a[k] + of[3] * c[k];
            for (int j = 0; j < 6; j++)
                M[k][j] += on_a * a[j] + on_b * b[j] + on_c * c[j];
        }
    }
    for (int k = 0; k < 6; k++)
        for (int j = 0; j < 6; j++)
            M[k][j] *= bending[0] * per_l * scale[k] * scale[j];
}
