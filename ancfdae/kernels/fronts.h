/* L D L^T of sparse symmetric matrices without exchanges of rows, by dense fronts (the multifrontal
 * method of Duff & Reid 1983). For real numbers.
 *
 * Unknowns are numbered in the order of elimination. A front is a dense matrix of f rows: the
 * first k are its pivots, numbered one after the other; the others are updated by them. Factors of a
 * front are the f x k columns below and on the diagonal, 1/D on the diagonal. What a front leaves to
 * the rows below its pivots waits on a stack until the front of the first of them takes it.
 *
 * Multipliers have zeros on the diagonal; the matrix that is factorised has -PERTURBED there, and
 * refinement of solutions removes the difference (docs/theory/09-linear-algebra.md).
 */

/* Fronts in the order of elimination. */
struct Fronts {
    Size n, count, most, stack; /* Unknowns, fronts, rows of the largest one, room of updates. */
    const int32_t *begin;       /* First pivot of each, and n. */
    const int64_t *row_at;      /* Where its row numbers begin. */
    const int32_t *rows;        /* Row numbers, ascending. */
    const int64_t *factor_at;   /* Where its factors begin. */
    const int32_t *children;    /* Fronts whose updates it takes from the stack. */
    const int64_t *column_at;   /* Lower triangle of the matrix: where columns begin, */
    const int32_t *column_rows; /* and their rows, the diagonal first. */
    const double *signs;        /* Of the pivots. */
};

/* The diagonal of scaled multipliers in what is factorised. Refinement shrinks errors by about this
 * factor over the smallest squared singular value of the scaled constraints. */
#define PERTURBED 1e-7

/* C -= L diag(d) (first n rows of L)^T, for m rows; blocks of 8 x 4 numbers stay in registers. `dl`
 * has room for 4 k. What stands above the diagonal of C is no result. */
WITH_WIDE_VECTORS void front_update(Size m, Size n, Size k, const double *__restrict L, Size ld,
                                    const double *__restrict d, double *__restrict dl,
                                    double *__restrict C, Size ldc)
{
    for (Size j = 0; j < n; j += 4) {
        Size wide = n - j < 4 ? n - j : 4, i = j;
        for (Size p = 0; p < k; p++)
            for (Size c = 0; c < 4; c++)
                dl[4 * p + c] = c < wide ? d[p] * L[p * ld + j + c] : 0;
        for (; i + 8 <= m; i += 8) {
            double sum[4][8] = {{0}};
            for (Size p = 0; p < k; p++) {
                const double *__restrict l = L + p * ld + i, *__restrict s = dl + 4 * p;
                for (int c = 0; c < 4; c++)
                    for (int r = 0; r < 8; r++)
                        sum[c][r] += s[c] * l[r];
            }
            for (Size c = 0; c < wide; c++)
                for (int r = 0; r < 8; r++)
                    C[(j + c) * ldc + i + r] -= sum[c][r];
        }
        for (; i < m; i++)
            for (Size c = 0; c < wide; c++) {
                double sum = 0;
                for (Size p = 0; p < k; p++)
                    sum += dl[4 * p + c] * L[p * ld + i];
                C[(j + c) * ldc + i] -= sum;
            }
    }
}

enum { PANEL = 16 };

/* Factorise the first k columns of a front in place, 1/D on the diagonal, and update the rest of
 * it, U. Returns 0, or the number of the pivot that has not its sign, unless signs are counted:
 * `excess` is by how many more pivots are negative than should be. `room` has 5 f numbers. */
Size front_factor(Size f, Size k, const double *signs, double *__restrict L, double *__restrict U,
                  double *__restrict room, Size *excess)
{
    double *d = room, *dl = room + f;
    for (Size j = 0; j < k; j += PANEL) {
        Size end = j + PANEL < k ? j + PANEL : k;
        for (Size p = j; p < end; p++) {
            double *__restrict own = L + p * f, pivot = own[p];
            /* The scaled diagonal had the size of one, or PERTURBED. */
            double least = ROUND_OFF * (signs[p] > 0 ? 1 : PERTURBED), signed_pivot = pivot * signs[p];
            if (!(signed_pivot > least)) {
                if (!excess || !(signed_pivot < -least))
                    return p + 1;
                *excess += signs[p] > 0 ? 1 : -1;
            }
            d[p] = pivot;
            double inverse = 1 / pivot;
            for (Size c = p + 1; c < end; c++) {
                double l = own[c] * inverse, *__restrict to = L + c * f;
                for (Size i = c; i < f; i++)
                    to[i] -= l * own[i];
            }
            for (Size i = p + 1; i < f; i++)
                own[i] *= inverse;
            own[p] = inverse;
        }
        front_update(f - end, k - end, end - j, L + j * f + end, f, d + j, dl, L + end * f + end,
                     f);
    }
    front_update(f - k, f - k, k, L + k, f, d, dl, U, f - k);
    return 0;
}

/* Factorise the scaled lower triangle `a`. Returns 0, or the number of the first pivot that has not
 * its sign, unless signs are counted. `stack` has the room of updates, `at` n numbers, `room` 5
 * times those of the largest front. */
Size fronts_factor(const Fronts *x, const double *__restrict a, double *__restrict factors,
                   double *__restrict stack, int32_t *__restrict at, double *room, Size *excess)
{
    double *top = stack;
    int32_t *updates = at + x->n; /* Fronts on the stack. */
    Size waiting = 0;
    memset(factors, 0, (size_t)x->factor_at[x->count] * sizeof *factors);
    for (Size s = 0; s < x->count; s++) {
        Size begin = x->begin[s], k = x->begin[s + 1] - begin;
        Size f = x->row_at[s + 1] - x->row_at[s], u = f - k;
        const int32_t *rows = x->rows + x->row_at[s];
        double *__restrict L = factors + x->factor_at[s], *__restrict U = top;
        for (Size i = 0; i < f; i++)
            at[rows[i]] = (int32_t)i;
        memset(U, 0, (size_t)(u * u) * sizeof *U);
        for (Size j = 0; j < k; j++)
            for (int64_t e = x->column_at[begin + j]; e < x->column_at[begin + j + 1]; e++)
                L[j * f + at[x->column_rows[e]]] += a[e];
        double *from = top;
        for (int32_t c = 0; c < x->children[s]; c++) {
            Size child = updates[--waiting], own = x->begin[child + 1] - x->begin[child];
            Size size = x->row_at[child + 1] - x->row_at[child] - own;
            const int32_t *below = x->rows + x->row_at[child] + own;
            from -= size * size;
            for (Size j = 0; j < size; j++) {
                Size column = at[below[j]];
                double *__restrict to = column < k ? L + column * f : U + (column - k) * u - k;
                for (Size i = j; i < size; i++)
                    to[at[below[i]]] += from[j * size + i];
            }
        }
        Size failed = front_factor(f, k, x->signs + begin, L, U, room, excess);
        if (failed)
            return begin + failed;
        memmove(from, U, (size_t)(u * u) * sizeof *U);
        top = from + u * u;
        updates[waiting++] = (int32_t)s;
    }
    return 0;
}

/* Solve for `wide` right sides, one beside the other in x; the compiler knows how many. `below` has
 * room for the rows of the largest front. */
INLINE void fronts_beside(int wide, const Fronts *q, const double *__restrict factors,
                          double *__restrict x, double *__restrict below)
{
    for (Size s = 0; s < q->count; s++) {
        Size k = q->begin[s + 1] - q->begin[s], f = q->row_at[s + 1] - q->row_at[s];
        const int32_t *rows = q->rows + q->row_at[s];
        const double *__restrict L = factors + q->factor_at[s];
        double *__restrict own = x + q->begin[s] * wide;
        memset(below, 0, (size_t)((f - k) * wide) * sizeof *below);
        for (Size j = 0; j < k; j++, L += f) {
            for (Size i = j + 1; i < k; i++)
                for (int r = 0; r < wide; r++)
                    own[i * wide + r] -= L[i] * own[j * wide + r];
            for (Size i = k; i < f; i++)
                for (int r = 0; r < wide; r++)
                    below[(i - k) * wide + r] += L[i] * own[j * wide + r];
        }
        for (Size i = k; i < f; i++)
            for (int r = 0; r < wide; r++)
                x[rows[i] * wide + r] -= below[(i - k) * wide + r];
    }
    for (Size s = q->count - 1; s >= 0; s--) {
        Size k = q->begin[s + 1] - q->begin[s], f = q->row_at[s + 1] - q->row_at[s];
        const int32_t *rows = q->rows + q->row_at[s];
        const double *__restrict L = factors + q->factor_at[s] + (k - 1) * f;
        double *__restrict own = x + q->begin[s] * wide;
        for (Size i = k; i < f; i++)
            for (int r = 0; r < wide; r++)
                below[(i - k) * wide + r] = x[rows[i] * wide + r];
        for (Size j = k - 1; j >= 0; j--, L -= f) {
            double sum[8];
            for (int r = 0; r < wide; r++)
                sum[r] = L[j] * own[j * wide + r];
            for (Size i = j + 1; i < k; i++)
                for (int r = 0; r < wide; r++)
                    sum[r] -= L[i] * own[i * wide + r];
            for (Size i = k; i < f; i++)
                for (int r = 0; r < wide; r++)
                    sum[r] -= L[i] * below[(i - k) * wide + r];
            for (int r = 0; r < wide; r++)
                own[j * wide + r] = sum[r];
        }
    }
}

/* r = b - A x for `wide` columns beside each other. */
INLINE void fronts_residual(int wide, const Fronts *q, const double *__restrict a,
                            const double *__restrict b, const double *__restrict x,
                            double *__restrict out)
{
    memcpy(out, b, (size_t)(q->n * wide) * sizeof *out);
    for (Size j = 0; j < q->n; j++) {
        int64_t e = q->column_at[j];
        for (int r = 0; r < wide; r++)
            out[j * wide + r] -= a[e] * x[j * wide + r];
        for (e++; e < q->column_at[j + 1]; e++) {
            Size i = q->column_rows[e];
            for (int r = 0; r < wide; r++) {
                out[i * wide + r] -= a[e] * x[j * wide + r];
                out[j * wide + r] -= a[e] * x[i * wide + r];
            }
        }
    }
}

/* A residual of this many units of round-off of the largest entries of b and x is not refined. */
#define REFINED 4
/* Refinements at most: each takes away seven digits, or five where constraints are almost
 * dependent. */
enum { MOST_REFINEMENTS = 5 };
/* A residual above this part of b and x is no round-off: constraints are almost dependent, and
 * refinement has not converged. */
#define UNREFINED 1e-12

/* A correction of Newton's method needs no more digits than this residual leaves: the next one
 * takes its error away. Anything else is solved to round-off. */
#define ENOUGH 1e-6
#define TO_ROUND_OFF (REFINED * DBL_EPSILON)

/* Solve, and refine down to a residual `enough`; returns the largest residual relative to the
 * entries of b and x. */
INLINE double fronts_refined(int wide, double enough, const Fronts *q, const double *a, const double *factors,
                             const double *__restrict b, double *__restrict x,
                             double *__restrict work, double *below)
{
    size_t size = (size_t)(q->n * wide);
    double last = INFINITY;
    memcpy(x, b, size * sizeof *x);
    fronts_beside(wide, q, factors, x, below);
    for (int turn = 0;; turn++) {
        double worst = 0;
        fronts_residual(wide, q, a, b, x, work);
        for (int r = 0; r < wide; r++) {
            double left = 0, most = 0;
            for (Size i = r; i < (Size)size; i += wide) {
                left = fmax(left, fabs(work[i]));
                most = fmax(most, fmax(fabs(b[i]), fabs(x[i])));
            }
            worst = left > 0 ? fmax(worst, left / most) : worst;
        }
        if (worst <= enough || turn == MOST_REFINEMENTS || !(worst < 0.5 * last))
            return worst;
        last = worst;
        fronts_beside(wide, q, factors, work, below);
        for (size_t i = 0; i < size; i++)
            x[i] += work[i];
    }
}

WITH_WIDE_VECTORS double fronts_one(double enough, const Fronts *q, const double *a, const double *factors,
                                    const double *b, double *x, double *work, double *below)
{
    return fronts_refined(1, enough, q, a, factors, b, x, work, below);
}

WITH_WIDE_VECTORS double fronts_four(double enough, const Fronts *q, const double *a, const double *factors,
                                     const double *b, double *x, double *work, double *below)
{
    return fronts_refined(4, enough, q, a, factors, b, x, work, below);
}

/* Solve for columns as `ldl_solve` takes them, of a matrix scaled by `scale`; `work` has room for
 * 12 n and 4 times the rows of the largest front. Returns the largest relative residual. */
double fronts_solve(double enough, const Fronts *q, const double *a, const double *factors, const int64_t *order,
                    const double *scale, Size columns, int parts, const double *__restrict right,
                    double *__restrict work, double *__restrict out)
{
    Size n = q->n;
    double worst = 0, *b = work, *x = b + 4 * n, *left = x + 4 * n, *below = left + 4 * n;
    for (Size c = 0; c < columns;) {
        int wide = columns - c > 1 ? 4 : 1, own = columns - c < wide ? (int)(columns - c) : wide;
        Size at[4];
        for (int r = 0; r < own; r++)
            at[r] = (c + r) / parts * n * parts + (c + r) % parts;
        for (Size i = 0; i < n; i++)
            for (int r = 0; r < wide; r++)
                b[i * wide + r] = r < own ? scale[i] * right[at[r] + order[i] * parts] : 0;
        double one = wide == 1 ? fronts_one(enough, q, a, factors, b, x, left, below)
                               : fronts_four(enough, q, a, factors, b, x, left, below);
        worst = one <= worst ? worst : one;
        for (Size i = 0; i < n; i++)
            for (int r = 0; r < own; r++)
                out[at[r] + order[i] * parts] = scale[i] * x[i * wide + r];
        c += own;
    }
    return worst;
}

/* The nearest power of two to 1/sqrt(x): it scales without round-off. */
INLINE double power_of_two(double x)
{
    int e;
    frexp(x, &e);
    return ldexp(1.0, -(int)floor(0.5 * e + 0.5));
}

/* Scale the lower triangle `a` in place so that the diagonal of coordinates and the largest entry
 * of each multiplier have the size of one, and write -PERTURBED to diagonals of multipliers in
 * `perturbed`, else a copy. Returns 0 unless the diagonal of coordinates is positive. */
int fronts_scaled(const Fronts *q, double *__restrict a, double *__restrict scale,
                  double *__restrict perturbed)
{
    Size n = q->n;
    double sum = 0;
    for (int64_t e = 0; e < q->column_at[n]; e++)
        sum += 0 * a[e];
    if (sum != 0)
        return 0;
    for (Size j = 0; j < n; j++) {
        double own = a[q->column_at[j]];
        scale[j] = 0;
        if (q->signs[j] > 0) {
            if (!(own > 0))
                return 0;
            scale[j] = power_of_two(own);
        }
    }
    /* Multipliers meet coordinates only; their largest scaled entries gather in `perturbed`. */
    memset(perturbed, 0, (size_t)n * sizeof *perturbed);
    for (Size j = 0; j < n; j++)
        for (int64_t e = q->column_at[j] + 1; e < q->column_at[j + 1]; e++) {
            Size i = q->column_rows[e];
            if (q->signs[i] * q->signs[j] < 0) {
                Size row = q->signs[i] < 0 ? i : j, column = i + j - row;
                perturbed[row] = fmax(perturbed[row], fabs(a[e]) * scale[column]);
            }
        }
    for (Size j = 0; j < n; j++)
        if (q->signs[j] < 0)
            scale[j] = perturbed[j] > 0 ? power_of_two(perturbed[j] * perturbed[j]) : 1;
    for (Size j = 0; j < n; j++)
        for (int64_t e = q->column_at[j]; e < q->column_at[j + 1]; e++)
            a[e] *= scale[j] * scale[q->column_rows[e]];
    memcpy(perturbed, a, (size_t)q->column_at[n] * sizeof *perturbed);
    for (Size j = 0; j < n; j++)
        if (q->signs[j] < 0)
            perturbed[q->column_at[j]] -= PERTURBED;
    return 1;
}

/* The matrix with its scale, and room for a factorisation. */
struct FrontRoom {
    double *a, *scale, *perturbed, *stack, *room;
    int32_t *at;
};

/* Scale and factorise what stands in `a`. Returns 0, or the number of the first pivot that has not
 * its sign, or 1 unless the diagonal of coordinates is positive. Signs are counted in `excess`. */
Size fronts_factored(const Fronts *q, const FrontRoom *x, double *factors, Size *excess = nullptr)
{
    if (!fronts_scaled(q, x->a, x->scale, x->perturbed))
        return 1;
    return fronts_factor(q, x->perturbed, factors, x->stack, x->at, x->room, excess);
}

/* The largest sum_k L_ik^2 |D_k| over the squared scale of row i; `sums` has room for n numbers. */
double fronts_growth(const Fronts *q, const double *scale, const double *factors, double *sums)
{
    double growth = 0;
    memset(sums, 0, (size_t)q->n * sizeof *sums);
    for (Size s = 0; s < q->count; s++) {
        Size k = q->begin[s + 1] - q->begin[s], f = q->row_at[s + 1] - q->row_at[s];
        const int32_t *rows = q->rows + q->row_at[s];
        const double *L = factors + q->factor_at[s];
        for (Size j = 0; j < k; j++, L += f) {
            double D = fabs(1 / L[j]);
            sums[rows[j]] += D;
            for (Size i = j + 1; i < f; i++)
                sums[rows[i]] += L[i] * L[i] * D;
        }
    }
    for (Size i = 0; i < q->n; i++)
        growth = fmax(growth, sums[i] / (scale[i] * scale[i]));
    return growth;
}
