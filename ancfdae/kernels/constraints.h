/* Constraints of joints, polynomials in their vectors U = L q, for one scalar type.
 *
 *     Phi = sum of a (e . U) + sum of s U_i . U_j - offset
 *
 * and a formula Phi(U, z) of some joints (`constraint_formulas.h`).
 *
 * Numbers of all joints stand joint by joint: l are the entries of L, and c = (a, s, offset, z) the
 * coefficients. Those that depend on time are sums over parts, c = sum of factor_p(t) part_p; part 0
 * has an entry for every coefficient, the others are lists. A time derivative of order n takes those
 * of the coefficients, c[k], and of the coordinates, X[k], by Leibniz' rule; c[k] is nullptr where it
 * vanishes.
 */

template <class T> struct ConstraintNumbers {
    const T *l, *part_0, *moving;
};

/* c[k] of the orders up to n; `work` has room for n + 1 rows of all coefficients. */
template <class T>
INLINE void coefficients(const ConstraintTable *p, const ConstraintNumbers<T> *of, int n, Size k,
                         Size instants, const T *factors, T *work, const T **c)
{
    for (int order = 0; order <= n; order++, work += p->n_c) {
        const T *factor = factors + (order * instants + k) * p->n_parts;
        int some = 0;
        for (Size part = 0; part < p->n_parts; part++)
            some |= factor[part] != 0;
        c[order] = some ? work : nullptr;
        if (some && p->n_moving == 0 && factor[0] == 1) {
            c[order] = of->part_0;
            continue;
        }
        for (Size e = 0; some && e < p->n_c; e++)
            work[e] = factor[0] * of->part_0[e];
        for (Size e = 0; some && e < p->n_moving; e++)
            work[p->moving_at[e]] += factor[p->moving_part[e]] * of->moving[e];
    }
}

/* U[k] of one joint, rows of p->most numbers. */
template <class T>
INLINE void joint_vectors(const ConstraintTable *p, const T *l, const int32_t *joint, int n,
                          const T *const *X, T *U)
{
    int32_t begin = joint[VECTOR] * p->d, end = joint[JOINT_ITEMS + VECTOR] * p->d;
    for (int k = 0; k <= n; k++, U += p->most)
        for (int32_t r = begin; r < end; r++) {
            T sum = 0;
            for (int32_t e = p->first[r]; e < p->first[r + 1]; e++)
                sum += l[e] * X[k][p->columns[e]];
            U[r - begin] = sum;
        }
}

/* The time derivative of order m of U_i . U_j. */
template <class T>
INLINE T joint_product(const ConstraintTable *p, int m, int32_t i, int32_t j, const T *U)
{
    T sum = 0;
    for (int k = 0; k <= m; k++) {
        T product = 0;
        for (int x = 0; x < p->d; x++)
            product += U[k * p->most + i + x] * U[(m - k) * p->most + j + x];
        sum += BINOMIAL[m][k] * product;
    }
    return sum;
}

/* Phi of one joint, or its time derivative of order n, added to rows of out. */
template <class T>
INLINE void joint_rate(const ConstraintTable *p, const int32_t *joint, int n, const T *const *c,
                       const T *U, T *out)
{
    const int32_t *next = joint + JOINT_ITEMS;
    int32_t begin = joint[VECTOR] * p->d;
    for (int k = 0; k <= n; k++) {
        if (!c[k])
            continue;
        const T *V = U + (n - k) * p->most, *s = c[k] + p->n_a;
        for (int32_t e = joint[LINEAR]; e < next[LINEAR]; e++)
            out[p->linear_row[e]] += BINOMIAL[n][k] * c[k][e] * V[p->linear_at[e] - begin];
        for (int32_t e = joint[PRODUCT]; e < next[PRODUCT]; e++)
            out[p->row[e]] += BINOMIAL[n][k] * s[e] *
                              joint_product<T>(p, n - k, p->i[e] - begin, p->j[e] - begin, U);
    }
    for (int32_t r = joint[ROW]; c[n] && r < next[ROW]; r++)
        out[r] -= c[n][p->n_a + p->n_s + r];
}

/* The same of component x of the factor of U_i in the partial of a product, times its s. */
template <class T>
INLINE T joint_partner(const ConstraintTable *p, int n, int32_t e, int32_t at, const T *const *c,
                       const T *U)
{
    T sum = 0;
    for (int k = 0; k <= n; k++)
        if (c[k])
            sum += BINOMIAL[n][k] * c[k][p->n_a + e] * U[(n - k) * p->most + at];
    return sum;
}

/* Phi_q of one joint, or its time derivative of order n: where there is lam, Phi_q^T lam is added to
 * out, else the values to their places. */
template <class T>
INLINE void joint_tangent(const ConstraintTable *p, const T *l, const int32_t *joint, int n,
                          const T *const *c, const T *U, const T *lam, T *out)
{
    const int32_t *next = joint + JOINT_ITEMS;
    const int32_t *place = p->place_linear + joint[PLACE_LINEAR];
    int32_t begin = joint[VECTOR] * p->d;
    for (int32_t e = joint[LINEAR]; c[n] && e < next[LINEAR]; e++) {
        T own = lam ? c[n][e] * lam[p->linear_row[e]] : c[n][e];
        for (int32_t at = p->first[p->linear_at[e]]; at < p->first[p->linear_at[e] + 1]; at++)
            out[lam ? p->columns[at] : *place++] += own * l[at];
    }
    place = p->place_product + joint[PLACE_PRODUCT];
    for (int32_t e = joint[PRODUCT]; e < next[PRODUCT]; e++)
        for (int x = 0; x < 2 * p->d; x++) {
            int32_t at = x < p->d ? p->i[e] + x : p->j[e] + x - p->d;
            int32_t partner = x < p->d ? p->j[e] + x : p->i[e] + x - p->d;
            T own = joint_partner<T>(p, n, e, partner - begin, c, U);
            own = lam ? own * lam[p->row[e]] : own;
            for (int32_t m = p->first[at]; m < p->first[at + 1]; m++)
                out[lam ? p->columns[m] : *place++] += own * l[m];
        }
}

/* The time derivative of order n of (Phi_q^T lam)_q of all joints with lam held, added to values at
 * places. */
template <class T>
INLINE void constraint_curvature(const ConstraintTable *p, const T *l, int n, const T *const *c,
                                 const T *const *X, const T *lam, T *U, T *out)
{
    const int32_t *place = p->curved, *joint = p->joints;
    for (Size e = 0; c[n] && e < p->n_s; e++) {
        T own = lam[p->row[e]] * c[n][p->n_a + e];
        for (int x = 0; x < p->d; x++)
            for (int32_t m = p->first[p->i[e] + x]; m < p->first[p->i[e] + x + 1]; m++)
                for (int32_t o = p->first[p->j[e] + x]; o < p->first[p->j[e] + x + 1]; o++) {
                    out[*place++] += own * l[m] * l[o];
                    out[*place++] += own * l[m] * l[o];
                }
    }
    if (!p->n_formulas)
        return;
    place = p->curved_formula;
    for (; joint < p->joints + p->n_joints * JOINT_ITEMS; joint += JOINT_ITEMS)
        if (const Formula *of = formula_of(p, joint)) {
            joint_vectors<T>(p, l, joint, n, X, U);
            place = formula_curvature<T>(p, l, joint, of, n, c, U, lam, place, out);
        }
}

/* Partials of w . Phi, or of its time derivative of order n, of one joint in l, and in c[k]. */
template <class T>
INLINE void joint_gradient(const ConstraintTable *p, const int32_t *joint, int n, const T *const *c,
                           const T *const *X, const T *U, const T *w, T *on_l, T *on_c)
{
    const int32_t *next = joint + JOINT_ITEMS;
    int32_t begin = joint[VECTOR] * p->d;
    for (int k = 0; k <= n; k++) {
        T *on = on_c + k * p->n_c;
        const T *V = U + (n - k) * p->most;
        for (int32_t e = joint[LINEAR]; e < next[LINEAR]; e++)
            on[e] = BINOMIAL[n][k] * w[p->linear_row[e]] * V[p->linear_at[e] - begin];
        for (int32_t e = joint[PRODUCT]; e < next[PRODUCT]; e++)
            on[p->n_a + e] = BINOMIAL[n][k] * w[p->row[e]] *
                             joint_product<T>(p, n - k, p->i[e] - begin, p->j[e] - begin, U);
        /* What the order k of the coordinates is multiplied with: Phi_U of order n - k. */
        int m = n - k;
        for (int32_t e = joint[LINEAR]; c[m] && e < next[LINEAR]; e++)
            for (int32_t at = p->first[p->linear_at[e]]; at < p->first[p->linear_at[e] + 1]; at++)
                on_l[at] += BINOMIAL[n][k] * w[p->linear_row[e]] * c[m][e] * X[k][p->columns[at]];
        for (int32_t e = joint[PRODUCT]; e < next[PRODUCT]; e++)
            for (int x = 0; x < 2 * p->d; x++) {
                int32_t at = x < p->d ? p->i[e] + x : p->j[e] + x - p->d;
                int32_t partner = x < p->d ? p->j[e] + x : p->i[e] + x - p->d;
                T own = BINOMIAL[n][k] * w[p->row[e]] *
                        joint_partner<T>(p, m, e, partner - begin, c, U);
                for (int32_t o = p->first[at]; o < p->first[at + 1]; o++)
                    on_l[o] += own * X[k][p->columns[o]];
            }
    }
    for (int32_t r = joint[ROW]; r < next[ROW]; r++)
        on_c[n * p->n_c + p->n_a + p->n_s + r] = -w[r];
}

/* Phi (n_lam), Phi_q (values on its pattern) or Phi_q^T lam (n_q) of one joint, or their time
 * derivatives of order n, added to out. `U` has `vectors_room`. */
template <class T>
INLINE void one_constraint(const ConstraintTable *p, const T *l, const int32_t *joint, int what,
                           int n, const T *const *c, const T *const *X, const T *lam, T *U, T *out)
{
    joint_vectors<T>(p, l, joint, n, X, U);
    if (what == RATE)
        joint_rate<T>(p, joint, n, c, U, out);
    else
        joint_tangent<T>(p, l, joint, n, c, U, what == FORCE ? lam : nullptr, out);
    if (const Formula *of = formula_of(p, joint)) {
        if (what == RATE)
            formula_rate<T>(p, joint, of, n, c, U, out);
        else
            formula_tangent<T>(p, l, joint, of, n, c, U, what == FORCE ? lam : nullptr, out);
    }
}

/* The same of all joints. */
template <class T>
void constraints(const ConstraintTable *p, const T *l, int what, int n, const T *const *c,
                 const T *const *X, const T *lam, T *U, T *out)
{
    const int32_t *joint = p->joints, *end = joint + p->n_joints * JOINT_ITEMS;
    if (n == 0 && what == RATE)
        for (; joint < end; joint += JOINT_ITEMS)
            one_constraint<T>(p, l, joint, RATE, 0, c, X, lam, U, out);
    else if (n == 0 && what == VALUES)
        for (; joint < end; joint += JOINT_ITEMS)
            one_constraint<T>(p, l, joint, VALUES, 0, c, X, lam, U, out);
    else
        for (; joint < end; joint += JOINT_ITEMS)
            one_constraint<T>(p, l, joint, what, n, c, X, lam, U, out);
}

/* Partials of lam . Phi of order n in l and in the coefficients, of all joints; on_l is added to. */
template <class T>
void constraint_gradient(const ConstraintTable *p, const T *l, int n, const T *const *c,
                         const T *const *X, const T *lam, T *U, T *on_l, T *on_c)
{
    const int32_t *joint = p->joints, *end = joint + p->n_joints * JOINT_ITEMS;
    for (; joint < end; joint += JOINT_ITEMS) {
        joint_vectors<T>(p, l, joint, n, X, U);
        joint_gradient<T>(p, joint, n, c, X, U, lam, on_l, on_c);
        if (const Formula *of = formula_of(p, joint))
            formula_gradient<T>(p, joint, of, n, c, X, U, lam, on_l, on_c);
    }
}
