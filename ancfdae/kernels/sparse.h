/* Products with matrices in compressed sparse rows, for one scalar type of both factors. */

/* out = M x for k rows x of n_columns numbers; out has k rows of n_rows. Rows go by fours, which
 * share the reading of the matrix. */
static void NAME(csr_rows)(npy_intp n_rows, const npy_int32 *first, const npy_int32 *columns,
                           const T *values, npy_intp k, npy_intp n_columns, const T *x, T *out)
{
    for (; k >= 4; k -= 4, x += 4 * n_columns, out += 4 * n_rows)
        for (npy_intp i = 0; i < n_rows; i++) {
            T sum[4] = {0, 0, 0, 0};
            for (npy_int32 at = first[i]; at < first[i + 1]; at++)
                for (int r = 0; r < 4; r++)
                    sum[r] += values[at] * x[r * n_columns + columns[at]];
            for (int r = 0; r < 4; r++)
                out[r * n_rows + i] = sum[r];
        }
    for (; k > 0; k--, x += n_columns, out += n_rows)
        for (npy_intp i = 0; i < n_rows; i++) {
            T sum = 0;
            for (npy_int32 at = first[i]; at < first[i + 1]; at++)
                sum += values[at] * x[columns[at]];
            out[i] = sum;
        }
}

/* out = M^T x for k rows x of n_rows numbers; out has k rows of n_columns, zero before. */
static void NAME(csr_rows_transposed)(npy_intp n_rows, const npy_int32 *first,
                                      const npy_int32 *columns, const T *values, npy_intp k,
                                      npy_intp n_columns, const T *x, T *out)
{
    for (; k > 0; k--, x += n_rows, out += n_columns)
        for (npy_intp i = 0; i < n_rows; i++)
            for (npy_int32 at = first[i]; at < first[i + 1]; at++)
                out[columns[at]] += values[at] * x[i];
}
