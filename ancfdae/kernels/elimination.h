/* Which fronts (`fronts.h`) the elimination of a symmetric matrix has, from its pattern alone.
 *
 * The parent of column j is the row of its first entry below the diagonal of L (Liu 1990); columns
 * are renumbered so that children come before their parents, one family behind the other. Columns
 * of one structure form a front; a front joins the next one where that stores few zeros more.
 */

typedef struct {
    npy_intp n;
    npy_int32 *parent, *count, *post, *place; /* n each; rows of a column of L, the new order. */
    npy_int64 *first;                         /* n + 1; entries left of the diagonal, */
    npy_int32 *columns;                       /* row by row. */
    npy_int32 *mark, *head, *next;            /* n + 1 each. */
} elimination;

/* Parents, from entries left of the diagonal (Liu 1990, with compressed paths). */
static void elimination_parents(elimination *x)
{
    npy_int32 *ancestor = x->mark;
    for (npy_intp i = 0; i < x->n; i++) {
        x->parent[i] = ancestor[i] = -1;
        for (npy_int64 e = x->first[i]; e < x->first[i + 1]; e++)
            for (npy_int32 j = x->columns[e], up; j != -1 && j != i; j = up) {
                up = ancestor[j];
                ancestor[j] = (npy_int32)i;
                if (up == -1)
                    x->parent[j] = (npy_int32)i;
            }
    }
}

/* Number of rows of each column of L, the diagonal included: column j has row i where a path from
 * an entry of row i leads through j. */
static void elimination_counts(elimination *x)
{
    for (npy_intp i = 0; i < x->n; i++)
        x->count[i] = 1, x->mark[i] = -1;
    for (npy_intp i = 0; i < x->n; i++) {
        x->mark[i] = (npy_int32)i;
        for (npy_int64 e = x->first[i]; e < x->first[i + 1]; e++)
            for (npy_int32 j = x->columns[e]; x->mark[j] != i; j = x->parent[j])
                x->mark[j] = (npy_int32)i, x->count[j]++;
    }
}

/* Children before parents, the one with most rows last, so that it may join its parent. */
static void elimination_postorder(elimination *x)
{
    npy_intp n = x->n, N = 0;
    npy_int32 *head = x->head, *next = x->next, *stack = x->mark;
    for (npy_intp i = 0; i <= n; i++)
        head[i] = -1;
    for (npy_intp i = n - 1; i >= 0; i--) {
        npy_intp p = x->parent[i] < 0 ? n : x->parent[i];
        next[i] = head[p], head[p] = (npy_int32)i;
    }
    for (npy_intp p = 0; p < n; p++) {
        npy_int32 most = head[p], before = -1, last = -1;
        for (npy_int32 i = head[p], left = -1; i >= 0; left = i, i = next[i]) {
            if (x->count[i] > x->count[most])
                most = i, before = left;
            last = i;
        }
        if (most == last)
            continue;
        if (before < 0)
            head[p] = next[most];
        else
            next[before] = next[most];
        next[last] = most, next[most] = -1;
    }
    npy_intp top = 0;
    for (npy_int32 root = head[n]; root >= 0; root = next[root]) {
        stack[top++] = root;
        while (top) {
            npy_int32 i = stack[top - 1];
            if (head[i] >= 0) {
                stack[top++] = head[i];
                head[i] = next[head[i]];
            } else {
                x->post[N++] = i;
                top--;
            }
        }
    }
    for (npy_intp i = 0; i < n; i++)
        x->place[x->post[i]] = (npy_int32)i;
}

/* Whether a front of k columns in all may store a part of zeros (the rule of CHOLMOD; Chen, Davis,
 * Hager & Rajamanickam 2008). */
static int joined(double k, double zeros)
{
    return k <= 4 || (k <= 16 && zeros < 0.8) || (k <= 48 && zeros < 0.1) || zeros < 0.05;
}

/* Write the first pivots and the numbers of rows of fronts; returns how many there are. Counts and
 * parents are in the new order. */
static npy_intp elimination_fronts(npy_intp n, const npy_int32 *parent, const npy_int32 *count,
                                   npy_int32 *begin, npy_int32 *rows, double *zeros)
{
    npy_intp N = 0;
    for (npy_intp j = 0; j < n; j++) {
        if (j == 0 || parent[j - 1] != j || count[j - 1] != count[j] + 1)
            begin[N] = (npy_int32)j, rows[N] = count[j], zeros[N++] = 0;
        int last = j + 1 == n || parent[j] != j + 1 || count[j] != count[j + 1] + 1;
        while (last && N > 1) {
            npy_intp own = begin[N - 1], before = begin[N - 2], up = parent[own - 1];
            double k = (double)(j + 1 - before), left = (double)(own - before);
            double f = left + rows[N - 1];
            double more = zeros[N - 1] + zeros[N - 2] + left * (f - rows[N - 2]);
            if (up < own || up > j || !joined(k, more / (k * f - 0.5 * k * k)))
                break;
            N--;
            zeros[N - 1] = more, rows[N - 1] = (npy_int32)f;
        }
    }
    begin[N] = (npy_int32)n;
    return N;
}

static int by_number(const void *a, const void *b)
{
    npy_int32 x = *(const npy_int32 *)a, y = *(const npy_int32 *)b;
    return (x > y) - (x < y);
}

/* Fronts of the renumbered matrix with their rows; `below` holds, column by column from `down` on,
 * rows below the diagonal. Returns the multiplications; `stack` and `most` as in `fronts`. */
static double elimination_rows(npy_intp n, npy_intp N, const npy_int32 *begin, const npy_int64 *down,
                               const npy_int32 *below, const npy_int64 *row_at, npy_int32 *rows,
                               npy_int64 *factor_at, npy_int32 *children, npy_int32 *mark,
                               npy_int32 *front_of, npy_int32 *lists, npy_intp *stack,
                               npy_intp *most)
{
    npy_int32 *head = lists, *next = lists + N;
    double work = 0;
    npy_intp top = 0;
    *stack = *most = 0;
    factor_at[0] = 0;
    for (npy_intp s = 0; s < N; s++) {
        head[s] = -1, children[s] = 0;
        for (npy_int32 j = begin[s]; j < begin[s + 1]; j++)
            front_of[j] = (npy_int32)s, mark[j] = -1;
    }
    for (npy_intp s = 0; s < N; s++) {
        npy_int32 end = begin[s + 1], *own = rows + row_at[s];
        npy_intp f = 0, k = end - begin[s], taken = 0;
        for (npy_int32 j = begin[s]; j < end; j++)
            own[f++] = j;
        for (npy_int32 j = begin[s]; j < end; j++)
            for (npy_int64 e = down[j]; e < down[j + 1]; e++)
                if (below[e] >= end && mark[below[e]] != s)
                    mark[below[e]] = (npy_int32)s, own[f++] = below[e];
        for (npy_int32 c = head[s]; c >= 0; c = next[c]) {
            npy_intp pivots = begin[c + 1] - begin[c], size = row_at[c + 1] - row_at[c] - pivots;
            taken += size * size;
            children[s]++;
            for (npy_int64 e = row_at[c] + pivots; e < row_at[c + 1]; e++)
                if (rows[e] >= end && mark[rows[e]] != s)
                    mark[rows[e]] = (npy_int32)s, own[f++] = rows[e];
        }
        qsort(own + k, (size_t)(f - k), sizeof *own, by_number);
        if (f > k) {
            npy_int32 up = front_of[own[k]];
            next[s] = head[up], head[up] = (npy_int32)s;
        }
        npy_intp u = f - k;
        *stack = top + u * u > *stack ? top + u * u : *stack;
        top += u * u - taken;
        *most = f > *most ? f : *most;
        factor_at[s + 1] = factor_at[s] + f * k;
        for (npy_intp j = 0; j < k; j++)
            work += 0.5 * (double)(f - j) * (double)(f - j);
    }
    return work;
}
