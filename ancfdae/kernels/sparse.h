/* Products with matrices in compressed sparse rows, for one scalar type of both factors. */

/* out += s M x for `wide` vectors, one beside the other in x; the first `own` count, and are rows of
 * `width` numbers of out. The compiler knows how many are wide. */
INLINE void NAME(csr_beside)(int wide, int own, npy_intp n_rows, const npy_int32 *restrict first,
                             const npy_int32 *restrict columns, const T *restrict values,
                             const T *restrict x, double s, npy_intp width, T *restrict out)
{
    for (npy_intp i = 0; i < n_rows; i++) {
        T sum[8] = {0};
        for (npy_int32 at = first[i]; at < first[i + 1]; at++) {
            const T *restrict from = x + (npy_intp)columns[at] * wide;
            T value = values[at];
            UNROLL_NOT
            for (int r = 0; r < wide; r++)
                sum[r] += value * from[r];
        }
        for (int r = 0; r < own; r++)
            out[r * width + i] += s * sum[r];
    }
}

/* The same for one; sums apart do not wait for each other. */
INLINE void NAME(csr_alone)(npy_intp n_rows, const npy_int32 *restrict first,
                            const npy_int32 *restrict columns, const T *restrict values,
                            const T *restrict x, double s, T *restrict out)
{
    for (npy_intp i = 0; i < n_rows; i++) {
        npy_int32 at = first[i], end = first[i + 1];
        T even = 0, odd = 0;
        for (; at + 1 < end; at += 2) {
            even += values[at] * x[columns[at]];
            odd += values[at + 1] * x[columns[at + 1]];
        }
        if (at < end)
            even += values[at] * x[columns[at]];
        out[i] += s * (even + odd);
    }
}

/* out += s M x for k rows x of n_columns numbers; rows of out have `width`. The work has room for
 * 8 n_columns. */
CLONES static void NAME(csr_rows)(npy_intp n_rows, const npy_int32 *first, const npy_int32 *columns,
                                  const T *values, npy_intp k, npy_intp n_columns, const T *x,
                                  T *restrict work, double s, npy_intp width, T *out)
{
    while (k > 0) {
        int wide = k > 4 ? 8 : k > 1 ? 4 : 1, own = k < wide ? (int)k : wide;
        if (wide == 1)
            NAME(csr_alone)(n_rows, first, columns, values, x, s, out);
        else {
            for (npy_intp i = 0; i < n_columns; i++)
                for (int r = 0; r < wide; r++)
                    work[i * wide + r] = r < own ? x[r * n_columns + i] : 0;
            if (wide == 8)
                NAME(csr_beside)(8, own, n_rows, first, columns, values, work, s, width, out);
            else
                NAME(csr_beside)(4, own, n_rows, first, columns, values, work, s, width, out);
        }
        k -= own, x += own * n_columns, out += own * width;
    }
}

/* out += s M^T x for k rows x of n_rows numbers; rows of out have `width`. */
static void NAME(csr_rows_transposed)(npy_intp n_rows, const npy_int32 *first,
                                      const npy_int32 *columns, const T *values, npy_intp k,
                                      const T *x, double s, npy_intp width, T *out)
{
    for (; k > 0; k--, x += n_rows, out += width)
        for (npy_intp i = 0; i < n_rows; i++) {
            T own = s * x[i];
            for (npy_int32 at = first[i]; at < first[i + 1]; at++)
                out[columns[at]] += values[at] * own;
        }
}
