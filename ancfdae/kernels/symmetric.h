/* L D L^T of a symmetric matrix, without exchanges of rows, for one scalar type.
 *
 * Of column k the rows k to k + first[k+1] - first[k] - 1 are stored, one behind the other from
 * a[first[k]] on; no column ends before the one to its left, so that the factors fill the same
 * places. Pivots of coordinates are positive where K is positive definite, those of multipliers
 * negative: then no exchange is needed (docs/theory/09-linear-algebra.md).
 */

/* Add s times chosen values, or all of them, at their places. */
template <class T>
void ldl_placed(Size n, const int32_t *__restrict chosen, const int32_t *__restrict places,
                double s, const T *__restrict values, T *__restrict a)
{
    for (Size i = 0; i < n; i++)
        a[places[i]] += s * values[chosen ? chosen[i] : i];
}

/* Factorise in place, 1/D on the diagonal. Returns 0, or the number of the first pivot that has
 * not its sign, or is the round-off of the diagonal; `least` has room for n. */
template <class T>
INLINE int ldl_factor_(Size n, const int32_t *__restrict first, const double *__restrict signs,
                       T *__restrict a, double *__restrict least)
{
    for (Size k = 0; k < n; k++)
        least[k] = ROUND_OFF * fabs(real_part(a[first[k]]));
    for (Size k = 0; k < n; k++) {
        T *column = a + first[k];
        int height = first[k + 1] - first[k] - 1;
        if (!(real_part(column[0]) * signs[k] > least[k]))
            return (int)k + 1;
        T inverse = 1 / column[0];
        for (int j = 1; j <= height; j++) {
            T l = column[j] * inverse, *__restrict to = a + first[k + j];
            const T *__restrict from = column + j;
            for (int i = 0; i <= height - j; i++)
                to[i] -= l * from[i];
        }
        for (int j = 1; j <= height; j++)
            column[j] *= inverse;
        column[0] = inverse;
    }
    return 0;
}

template <class T>
int ldl_factor(Size n, const int32_t *__restrict first, const double *__restrict signs,
               T *__restrict a, double *__restrict least)
{
    return widely<T>([=]() ALWAYS { return ldl_factor_<T>(n, first, signs, a, least); });
}

/* Solve for `wide` right sides, one beside the other in x; the compiler knows how many. */
template <class T>
INLINE void ldl_beside(int wide, Size n, const int32_t *__restrict first, const T *__restrict a,
                       T *__restrict x)
{
    for (Size k = 0; k < n; k++) {
        const T *__restrict column = a + first[k];
        T *__restrict own = x + k * wide;
        for (int j = 1, height = first[k + 1] - first[k]; j < height; j++) {
            T l = column[j], *__restrict to = own + j * wide;
            UNROLL_NOT
            for (int r = 0; r < wide; r++)
                to[r] -= l * own[r];
        }
    }
    for (Size k = n - 1; k >= 0; k--) {
        const T *__restrict column = a + first[k];
        T *__restrict own = x + k * wide, sum[8];
        for (int r = 0; r < wide; r++)
            sum[r] = column[0] * own[r];
        for (int j = 1, height = first[k + 1] - first[k]; j < height; j++) {
            T l = column[j];
            const T *__restrict from = own + j * wide;
            UNROLL_NOT
            for (int r = 0; r < wide; r++)
                sum[r] -= l * from[r];
        }
        for (int r = 0; r < wide; r++)
            own[r] = sum[r];
    }
}

/* The same for one; sums apart do not wait for each other. */
template <class T>
INLINE void ldl_alone(Size n, const int32_t *__restrict first, const T *__restrict a,
                      T *__restrict x)
{
    for (Size k = 0; k < n; k++) {
        const T *__restrict column = a + first[k];
        T own = x[k], *__restrict to = x + k;
        for (int j = 1, height = first[k + 1] - first[k]; j < height; j++)
            to[j] -= column[j] * own;
    }
    for (Size k = n - 1; k >= 0; k--) {
        const T *__restrict column = a + first[k], *__restrict from = x + k;
        int j = 1, height = first[k + 1] - first[k];
        T sum[4] = {0, 0, 0, 0};
        for (; j + 4 <= height; j += 4)
            for (int r = 0; r < 4; r++)
                sum[r] += column[j + r] * from[j + r];
        for (; j < height; j++)
            sum[0] += column[j] * from[j];
        x[k] = column[0] * x[k] - (sum[0] + sum[1] + sum[2] + sum[3]);
    }
}

/* Solve for columns; column c holds the numbers `part` = c % parts of row c / parts of n parts
 * numbers, in the order of the scene. The work has room for 8 n. */
template <class T>
INLINE void ldl_solve_(Size n, const int32_t *first, const T *a, const int64_t *__restrict order,
                       Size columns, int parts, const T *__restrict right, T *__restrict work,
                       T *__restrict out)
{
    for (Size c = 0; c < columns;) {
        Size left = columns - c;
        int wide = left > 4 ? 8 : left > 1 ? 4 : 1, own = left < wide ? (int)left : wide;
        Size at[8];
        for (int r = 0; r < own; r++)
            at[r] = (c + r) / parts * n * parts + (c + r) % parts;
        for (Size i = 0; i < n; i++)
            for (int r = 0; r < wide; r++)
                work[i * wide + r] = r < own ? right[at[r] + order[i] * parts] : 0;
        if (wide == 8)
            ldl_beside<T>(8, n, first, a, work);
        else if (wide == 4)
            ldl_beside<T>(4, n, first, a, work);
        else
            ldl_alone<T>(n, first, a, work);
        for (Size i = 0; i < n; i++)
            for (int r = 0; r < own; r++)
                out[at[r] + order[i] * parts] = work[i * wide + r];
        c += own;
    }
}

template <class T>
void ldl_solve(Size n, const int32_t *first, const T *a, const int64_t *__restrict order,
               Size columns, int parts, const T *__restrict right, T *__restrict work,
               T *__restrict out)
{
    widely<T>([=]() ALWAYS {
        return ldl_solve_<T>(n, first, a, order, columns, parts, right, work, out);
    });
}
