/* Joints whose equations are lists of operations, Phi(U, z), in their vectors U = L q and inputs z.
 *
 * Inputs are numbers behind the other coefficients: parameters, vectors of the reference and values
 * of laws, which factors of time multiply. Each function takes c[k] and U of the orders up to n as
 * those in `constraints.h`; numbers of the lists stand behind the rows of U.
 */

template <class T> const T *formula_constants(const Formula *of, int which)
{
    if constexpr (std::is_same<T, double>::value)
        return of->in_real[which];
    else
        return of->in_complex[which];
}

/* The formula of a joint; nullptr without one. */
INLINE const Formula *formula_of(const ConstraintTable *p, const int32_t *joint)
{
    int32_t at = p->n_formulas ? p->formula[(joint - p->joints) / JOINT_ITEMS] : -1;
    return at < 0 ? nullptr : p->formulas + at;
}

/* Room for vectors of a joint of the orders up to n, and for its lists. */
INLINE Size vectors_room(const ConstraintTable *p, int n) { return (n + 1) * p->most + p->room; }

/* Evaluates a list of which the orders up to n are inputs; U has rows up to `rows`. Returns numbers,
 * in which the outputs of the list are places. */
template <class T>
const T *formula_values(const ConstraintTable *p, const int32_t *joint, const Formula *of, int which,
                        int n, int rows, const T *const *c, T *U, const T *lam)
{
    const int32_t *next = joint + JOINT_ITEMS;
    const Operations *list = of->lists[which];
    const T *constants = formula_constants<T>(of, which);
    Size n_u = (next[VECTOR] - joint[VECTOR]) * p->d, n_z = next[INPUT] - joint[INPUT];
    T *numbers = U + (rows + 1) * p->most, *to = numbers;
    for (int k = 0; k <= n; k++, to += n_u + n_z) {
        memcpy(to, U + k * p->most, (size_t)n_u * sizeof *to);
        if (c[k])
            memcpy(to + n_u, c[k] + p->n_c - p->n_z + joint[INPUT], (size_t)n_z * sizeof *to);
        else
            memset(to + n_u, 0, (size_t)n_z * sizeof *to);
    }
    for (int32_t r = joint[ROW]; lam && r < next[ROW]; r++)
        *to++ = lam[r];
    memcpy(to, constants, (size_t)list->n_constants * sizeof *to);
    list_evaluated<T>(list, 1, numbers);
    return numbers;
}

/* Phi of order n, added to rows of out. */
template <class T>
void formula_rate(const ConstraintTable *p, const int32_t *joint, const Formula *of, int n,
                  const T *const *c, T *U, T *out)
{
    const T *found = formula_values<T>(p, joint, of, OF_PHI + n, n, n, c, U, nullptr);
    const int32_t *at = of->lists[OF_PHI + n]->outputs;
    for (int32_t r = joint[ROW]; r < joint[JOINT_ITEMS + ROW]; r++)
        out[r] += found[*at++];
}

/* Phi_q of order n: where there is lam, Phi_q^T lam is added to out, else values to their places. */
template <class T>
void formula_tangent(const ConstraintTable *p, const T *l, const int32_t *joint, const Formula *of,
                     int n, const T *const *c, T *U, const T *lam, T *out)
{
    const int32_t *next = joint + JOINT_ITEMS, *place = p->place_formula + joint[PLACE_FORMULA];
    const T *found = formula_values<T>(p, joint, of, OF_VECTORS + n, n, n, c, U, nullptr);
    const int32_t *at = of->lists[OF_VECTORS + n]->outputs;
    for (int32_t r = joint[ROW]; r < next[ROW]; r++)
        for (int32_t a = joint[VECTOR] * p->d; a < next[VECTOR] * p->d; a++) {
            T own = found[*at++];
            own = lam ? own * lam[r] : own;
            for (int32_t m = p->first[a]; m < p->first[a + 1]; m++)
                out[lam ? p->columns[m] : *place++] += own * l[m];
        }
}

/* The time derivative of order n of (Phi_q^T lam)_q with lam held, added to values at places, of
 * which the next is returned. */
template <class T>
const int32_t *formula_curvature(const ConstraintTable *p, const T *l, const int32_t *joint,
                                 const Formula *of, int n, const T *const *c, T *U, const T *lam,
                                 const int32_t *place, T *out)
{
    int32_t begin = joint[VECTOR] * p->d, end = joint[JOINT_ITEMS + VECTOR] * p->d;
    const T *found = formula_values<T>(p, joint, of, OF_CURVATURE + n, n, n, c, U, lam);
    const int32_t *at = of->lists[OF_CURVATURE + n]->outputs;
    for (int32_t a = begin; a < end; a++)
        for (int32_t b = begin; b < end; b++) {
            T own = found[*at++];
            for (int32_t m = p->first[a]; m < p->first[a + 1]; m++)
                for (int32_t o = p->first[b]; o < p->first[b + 1]; o++)
                    out[*place++] += own * l[m] * l[o];
        }
    return place;
}

/* Partials of w . Phi of order n in l, and in the inputs of each order: inputs of order k have the
 * factor by Leibniz' rule times Phi_U or Phi_z of order n - k. */
template <class T>
void formula_gradient(const ConstraintTable *p, const int32_t *joint, const Formula *of, int n,
                      const T *const *c, const T *const *X, T *U, const T *w, T *on_l, T *on_c)
{
    const int32_t *next = joint + JOINT_ITEMS;
    for (int k = 0; k <= n; k++) {
        const T *found = formula_values<T>(p, joint, of, OF_VECTORS + n - k, n - k, n, c, U, nullptr);
        const int32_t *at = of->lists[OF_VECTORS + n - k]->outputs;
        for (int32_t r = joint[ROW]; r < next[ROW]; r++)
            for (int32_t a = joint[VECTOR] * p->d; a < next[VECTOR] * p->d; a++) {
                T own = BINOMIAL[n][k] * w[r] * found[*at++];
                for (int32_t m = p->first[a]; m < p->first[a + 1]; m++)
                    on_l[m] += own * X[k][p->columns[m]];
            }
        found = formula_values<T>(p, joint, of, OF_INPUTS + n - k, n - k, n, c, U, nullptr);
        at = of->lists[OF_INPUTS + n - k]->outputs;
        T *on = on_c + k * p->n_c + p->n_c - p->n_z;
        for (int32_t r = joint[ROW]; r < next[ROW]; r++)
            for (int32_t i = joint[INPUT]; i < next[INPUT]; i++)
                on[i] += BINOMIAL[n][k] * w[r] * found[*at++];
    }
}
