/* L D L^T of a symmetric matrix, without exchanges of rows, for one scalar type.
 *
 * Of column k the rows k to k + first[k+1] - first[k] - 1 are stored, one behind the other from
 * a[first[k]] on; no column ends before the one to its left, so that the factors fill the same
 * places. Pivots of coordinates are positive where K is positive definite, those of multipliers
 * negative: then no exchange is needed (docs/theory/09-linear-algebra.md).
 */

/* Add s times chosen values, or all of them, at their places. */
static void NAME(ldl_placed)(npy_intp n, const npy_int32 *restrict chosen,
                             const npy_int32 *restrict places, double s, const T *restrict values,
                             T *restrict a)
{
    for (npy_intp i = 0; i < n; i++)
        a[places[i]] += s * values[chosen ? chosen[i] : i];
}

/* Factorise in place, 1/D on the diagonal. Returns 0, or the number of the first pivot that has
 * not its sign, or is the round-off of the diagonal; `least` has room for n. */
CLONES static int NAME(ldl_factor)(npy_intp n, const npy_int32 *restrict first,
                                   const double *restrict signs, T *restrict a,
                                   double *restrict least)
{
    for (npy_intp k = 0; k < n; k++)
        least[k] = ROUND_OFF * fabs(creal(a[first[k]]));
    for (npy_intp k = 0; k < n; k++) {
        T *column = a + first[k];
        int height = first[k + 1] - first[k] - 1;
        if (!(creal(column[0]) * signs[k] > least[k]))
            return (int)k + 1;
        T inverse = 1 / column[0];
        for (int j = 1; j <= height; j++) {
            T l = column[j] * inverse, *restrict to = a + first[k + j];
            const T *restrict from = column + j;
            for (int i = 0; i <= height - j; i++)
                to[i] -= l * from[i];
        }
        for (int j = 1; j <= height; j++)
            column[j] *= inverse;
        column[0] = inverse;
    }
    return 0;
}

/* Solve for `wide` right sides, one beside the other in x; the compiler knows how many. */
INLINE void NAME(ldl_beside)(int wide, npy_intp n, const npy_int32 *restrict first,
                             const T *restrict a, T *restrict x)
{
    for (npy_intp k = 0; k < n; k++) {
        const T *restrict column = a + first[k];
        T *restrict own = x + k * wide;
        for (int j = 1, height = first[k + 1] - first[k]; j < height; j++) {
            T l = column[j], *restrict to = own + j * wide;
            UNROLL_NOT
            for (int r = 0; r < wide; r++)
                to[r] -= l * own[r];
        }
    }
    for (npy_intp k = n - 1; k >= 0; k--) {
        const T *restrict column = a + first[k];
        T *restrict own = x + k * wide, sum[8];
        for (int r = 0; r < wide; r++)
            sum[r] = column[0] * own[r];
        for (int j = 1, height = first[k + 1] - first[k]; j < height; j++) {
            T l = column[j];
            const T *restrict from = own + j * wide;
            UNROLL_NOT
            for (int r = 0; r < wide; r++)
                sum[r] -= l * from[r];
        }
        for (int r = 0; r < wide; r++)
            own[r] = sum[r];
    }
}

/* The same for one; sums apart do not wait for each other. */
INLINE void NAME(ldl_alone)(npy_intp n, const npy_int32 *restrict first, const T *restrict a,
                            T *restrict x)
{
    for (npy_intp k = 0; k < n; k++) {
        const T *restrict column = a + first[k];
        T own = x[k], *restrict to = x + k;
        for (int j = 1, height = first[k + 1] - first[k]; j < height; j++)
            to[j] -= column[j] * own;
    }
    for (npy_intp k = n - 1; k >= 0; k--) {
        const T *restrict column = a + first[k], *restrict from = x + k;
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
CLONES static void NAME(ldl_solve)(npy_intp n, const npy_int32 *first, const T *a,
                                   const npy_int64 *restrict order, npy_intp columns, int parts,
                                   const T *restrict right, T *restrict work, T *restrict out)
{
    for (npy_intp c = 0; c < columns;) {
        npy_intp left = columns - c;
        int wide = left > 4 ? 8 : left > 1 ? 4 : 1, own = left < wide ? (int)left : wide;
        npy_intp at[8];
        for (int r = 0; r < own; r++)
            at[r] = (c + r) / parts * n * parts + (c + r) % parts;
        for (npy_intp i = 0; i < n; i++)
            for (int r = 0; r < wide; r++)
                work[i * wide + r] = r < own ? right[at[r] + order[i] * parts] : 0;
        if (wide == 8)
            NAME(ldl_beside)(8, n, first, a, work);
        else if (wide == 4)
            NAME(ldl_beside)(4, n, first, a, work);
        else
            NAME(ldl_alone)(n, first, a, work);
        for (npy_intp i = 0; i < n; i++)
            for (int r = 0; r < own; r++)
                out[at[r] + order[i] * parts] = work[i * wide + r];
        c += own;
    }
}
