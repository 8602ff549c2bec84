/* Constraints of all joints at one instant of a march, for one scalar type.
 *
 * With the vectors U = L q, Phi = sum a (e . U) + sum s U_i . U_j - offset. The raw Jacobian is the
 * list of nonzero entries of Phi_U: a for each linear entry, then s U_j of all bilinear ones, then
 * s U_i (docs/theory.md, section 3). Coefficients are sums of parts times factors of time.
 */

typedef struct {
    npy_intp n;
    const npy_int32 *first, *columns;
    const T *values;
} NAME(csr);

typedef struct {
    npy_intp n_lam, n_vectors, n_a, n_s, n_parts;
    int d;
    NAME(csr) L;
    const npy_int64 *a_row, *a_at, *s_row, *s_i, *s_j;
    const T *a, *s, *offset;
} NAME(joints);

/* Coefficients at an instant, one behind the other: a, s, offset. */
typedef struct {
    T *a, *s, *offset;
} NAME(coefficients);

/* out += M x. */
INLINE void NAME(csr_times)(const NAME(csr) *m, const T *x, T *out)
{
    NAME(csr_alone)(m->n, m->first, m->columns, m->values, x, 1, out);
}

INLINE void NAME(vectors_of)(const NAME(joints) *j, const T *q, T *U)
{
    for (npy_intp i = 0; i < j->n_vectors * j->d; i++)
        U[i] = 0;
    NAME(csr_times)(&j->L, q, U);
}

static void NAME(sum_of_parts)(npy_intp n_parts, npy_intp n, const double *factors, const T *parts,
                               T *sum)
{
    for (npy_intp i = 0; i < n; i++)
        sum[i] = factors[0] * parts[i];
    for (npy_intp k = 1; k < n_parts; k++)
        for (npy_intp i = 0; i < n; i++)
            sum[i] += factors[k] * parts[k * n + i];
}

static void NAME(coefficients_at)(const NAME(joints) *j, const double *factors,
                                  NAME(coefficients) *c)
{
    NAME(sum_of_parts)(j->n_parts, j->n_a, factors, j->a, c->a);
    NAME(sum_of_parts)(j->n_parts, j->n_s, factors, j->s, c->s);
    NAME(sum_of_parts)(j->n_parts, j->n_lam, factors, j->offset, c->offset);
}

INLINE T NAME(dot)(int d, const T *x, const T *y)
{
    T sum = 0;
    for (int c = 0; c < d; c++)
        sum += x[c] * y[c];
    return sum;
}

static void NAME(phi)(const NAME(joints) *j, const NAME(coefficients) *c, const T *U, T *Phi)
{
    for (npy_intp i = 0; i < j->n_lam; i++)
        Phi[i] = -c->offset[i];
    for (npy_intp i = 0; i < j->n_a; i++)
        Phi[j->a_row[i]] += c->a[i] * U[j->a_at[i]];
    for (npy_intp i = 0; i < j->n_s; i++)
        Phi[j->s_row[i]] += c->s[i] * NAME(dot)(j->d, U + j->s_i[i] * j->d, U + j->s_j[i] * j->d);
}

/* The first time derivative of Phi along V; c_t are the derivatives of the coefficients. */
static void NAME(phi_rate)(const NAME(joints) *j, const NAME(coefficients) *c,
                                  const NAME(coefficients) *c_t, const T *U, const T *V, T *rate)
{
    NAME(phi)(j, c_t, U, rate);
    for (npy_intp i = 0; i < j->n_a; i++)
        rate[j->a_row[i]] += c->a[i] * V[j->a_at[i]];
    for (npy_intp i = 0; i < j->n_s; i++) {
        npy_intp left = j->s_i[i] * j->d, right = j->s_j[i] * j->d;
        rate[j->s_row[i]] += c->s[i] * (NAME(dot)(j->d, U + left, V + right) +
                                        NAME(dot)(j->d, V + left, U + right));
    }
}

/* Nonzero entries of Phi_U. */
static void NAME(raw_jacobian)(const NAME(joints) *j, const NAME(coefficients) *c, const T *U,
                               T *raw)
{
    T *to_i = raw + j->n_a, *to_j = to_i + j->n_s * j->d;
    for (npy_intp i = 0; i < j->n_a; i++)
        raw[i] = c->a[i];
    for (npy_intp i = 0; i < j->n_s; i++)
        for (int k = 0; k < j->d; k++) {
            to_i[i * j->d + k] = c->s[i] * U[j->s_j[i] * j->d + k];
            to_j[i * j->d + k] = c->s[i] * U[j->s_i[i] * j->d + k];
        }
}
