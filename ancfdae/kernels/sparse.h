/* Products with matrices in compressed sparse rows, for one scalar type of both factors. */

/* out += s M x for `wide` vectors, one beside the other in x; the first `own` count, and are rows of
 * `width` numbers of out. The compiler knows how many are wide. Two rows at a time do not wait for
 * each other. */
template <class T>
INLINE void csr_beside(int wide, int own, Size n_rows, const int32_t *__restrict first,
                       const int32_t *__restrict columns, const T *__restrict values,
                       const T *__restrict x, double s, Size width, T *__restrict out)
{
    auto added = [=](int32_t at, T *__restrict sum) ALWAYS {
        const T *__restrict from = x + (Size)columns[at] * wide;
        T value = values[at];
        UNROLL_NOT
        for (int r = 0; r < wide; r++)
            sum[r] += value * from[r];
    };
    for (Size i = 0; i < n_rows; i += 2) {
        T one[8] = {0}, two[8] = {0};
        bool both = i + 1 < n_rows;
        int32_t at = first[i], end = first[i + 1], next = end, last = both ? first[i + 2] : end;
        for (; at < end && next < last; at++, next++) {
            added(at, one);
            added(next, two);
        }
        for (; at < end; at++)
            added(at, one);
        for (; next < last; next++)
            added(next, two);
        for (int r = 0; r < own; r++)
            out[r * width + i] += s * one[r];
        for (int r = 0; both && r < own; r++)
            out[r * width + i + 1] += s * two[r];
    }
}

/* The same for one; sums apart do not wait for each other. */
template <class T>
INLINE void csr_alone(Size n_rows, const int32_t *__restrict first,
                      const int32_t *__restrict columns, const T *__restrict values,
                      const T *__restrict x, double s, T *__restrict out)
{
    for (Size i = 0; i < n_rows; i++) {
        int32_t at = first[i], end = first[i + 1];
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
template <class T>
INLINE void csr_rows_(Size n_rows, const int32_t *first, const int32_t *columns, const T *values,
                      Size k, Size n_columns, const T *x, T *__restrict work, double s, Size width,
                      T *out)
{
    while (k > 0) {
        int wide = k > 4 ? 8 : k > 1 ? 4 : 1, own = k < wide ? (int)k : wide;
        if (wide == 1)
            csr_alone<T>(n_rows, first, columns, values, x, s, out);
        else {
            for (Size i = 0; i < n_columns; i++)
                for (int r = 0; r < wide; r++)
                    work[i * wide + r] = r < own ? x[r * n_columns + i] : 0;
            if (wide == 8)
                csr_beside<T>(8, own, n_rows, first, columns, values, work, s, width, out);
            else
                csr_beside<T>(4, own, n_rows, first, columns, values, work, s, width, out);
        }
        k -= own, x += own * n_columns, out += own * width;
    }
}

template <class T>
void csr_rows(Size n_rows, const int32_t *first, const int32_t *columns, const T *values, Size k,
              Size n_columns, const T *x, T *__restrict work, double s, Size width, T *out)
{
    widely<T>([=]() ALWAYS {
        return csr_rows_<T>(n_rows, first, columns, values, k, n_columns, x, work, s, width, out);
    });
}

/* out += s M^T x for k rows x of n_rows numbers; rows of out have `width`. */
template <class T>
void csr_rows_transposed(Size n_rows, const int32_t *first, const int32_t *columns, const T *values,
                         Size k, const T *x, double s, Size width, T *out)
{
    for (; k > 0; k--, x += n_rows, out += width)
        for (Size i = 0; i < n_rows; i++) {
            T own = s * x[i];
            for (int32_t at = first[i]; at < first[i + 1]; at++)
                out[columns[at]] += values[at] * own;
        }
}
