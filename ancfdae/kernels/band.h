/* Banded factorisation by LAPACK, for one scalar type of the matrix.
 *
 * The band has room for fill-in: entry (i, j) stands at row 2 half + i - j of column j, and a
 * column holds 3 half + 1 numbers. LAPACK's routines are those of SciPy.
 */

template <class T> using Gbtrf = void (*)(int *, int *, int *, int *, T *, int *, int *, int *);
template <class T>
using Gbtrs = void (*)(char *, int *, int *, int *, int *, T *, int *, int *, T *, int *, int *);

/* Scale values, write them where `flat` says, and factorise. Returns LAPACK's info, or -1 where a
 * value is not finite. The values of B come twice, for B and its transpose.
 *
 * Rows are exchanged by the size of their entries: B is multiplied with the size of the largest
 * scaled entry of K, so that neither units of time nor the length of a step matter. It is a power
 * of two, `of_B`, by which multipliers and constraints of right sides are scaled, too. */
template <class T>
int band_factor(Gbtrf<T> gbtrf, int n, int half, Size n_K, Size n_B, const T *K, const T *B,
                const double *factors, const int64_t *flat, T *band, int *pivots, double *of_B)
{
    int width = 3 * half + 1, info = 0, exponent = 0;
    double largest = 0;
    T sum = 0;
    for (Size i = 0; i < n_K; i++) {
        T value = K[i] * factors[i];
        double size = fabs(real_part(value)) + fabs(imaginary_part(value));
        largest = size > largest ? size : largest;
        sum += value;
        band[flat[i]] = value;
    }
    if (isfinite(largest))
        frexp(largest, &exponent);
    *of_B = ldexp(1, exponent);
    for (Size i = 0; i < n_B; i++) {
        T value = B[i] * (*of_B * factors[n_K + i]);
        sum += value;
        band[flat[n_K + i]] = band[flat[n_K + n_B + i]] = value;
    }
    if (!isfinite(real_part(sum)) || !isfinite(imaginary_part(sum)))
        return -1;
    gbtrf(&n, &n, &half, &half, band, &width, pivots, &info);
    return info;
}

/* Solve for rows of right sides that are numbered and scaled already. */
template <class T>
void band_solve(Gbtrs<T> gbtrs, char transposed, int n, int half, int rows, T *lu, int *pivots,
                T *right)
{
    int width = 3 * half + 1, info = 0;
    if (n == 0) /* LAPACK would complain about the rows of nothing. */
        return;
    gbtrs(&transposed, &n, &half, &half, &rows, lu, &width, pivots, right, &n, &info);
}

/* Number and scale rows of right sides, and back. A row has `parts` numbers for each unknown, one
 * beside the other there and one row behind the other here. */
template <class T>
void numbered(Size rows, Size n, int parts, const int64_t *order, const double *scale,
              const T *from, T *to, bool back)
{
    for (Size r = 0; r < rows; r++)
        for (int part = 0; part < parts; part++)
            for (Size i = 0; i < n; i++) {
                Size apart = (r * parts + part) * n + i;
                Size together = (r * n + order[i]) * parts + part;
                to[back ? together : apart] = scale[order[i]] * from[back ? apart : together];
            }
}
