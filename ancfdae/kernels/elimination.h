/* Which fronts (`fronts.h`) the elimination of a symmetric matrix has, from its pattern alone.
 *
 * The parent of column j is the row of its first entry below the diagonal of L (Liu 1990); columns
 * are renumbered so that children come before their parents, one family behind the other. Columns
 * of one structure form a front; a front joins the next one where that stores few zeros more.
 */

struct Elimination {
    Size n;
    int32_t *parent, *count, *post, *place; /* n each; rows of a column of L, the new order. */
    const int64_t *first;                   /* n + 1; entries left of the diagonal, */
    const int32_t *columns;                 /* row by row. */
    int32_t *mark, *head, *next;            /* n + 1 each. */
};

/* Parents, from entries left of the diagonal (Liu 1990, with compressed paths). */
void elimination_parents(Elimination *x)
{
    int32_t *ancestor = x->mark;
    for (Size i = 0; i < x->n; i++) {
        x->parent[i] = ancestor[i] = -1;
        for (int64_t e = x->first[i]; e < x->first[i + 1]; e++)
            for (int32_t j = x->columns[e], up; j != -1 && j != i; j = up) {
                up = ancestor[j];
                ancestor[j] = (int32_t)i;
                if (up == -1)
                    x->parent[j] = (int32_t)i;
            }
    }
}

/* Number of rows of each column of L, the diagonal included: column j has row i where a path from
 * an entry of row i leads through j. */
void elimination_counts(Elimination *x)
{
    for (Size i = 0; i < x->n; i++)
        x->count[i] = 1, x->mark[i] = -1;
    for (Size i = 0; i < x->n; i++) {
        x->mark[i] = (int32_t)i;
        for (int64_t e = x->first[i]; e < x->first[i + 1]; e++)
            for (int32_t j = x->columns[e]; x->mark[j] != i; j = x->parent[j])
                x->mark[j] = (int32_t)i, x->count[j]++;
    }
}

/* Children before parents, the one with most rows last, so that it may join its parent. */
void elimination_postorder(Elimination *x)
{
    Size n = x->n, N = 0;
    int32_t *head = x->head, *next = x->next, *stack = x->mark;
    for (Size i = 0; i <= n; i++)
        head[i] = -1;
    for (Size i = n - 1; i >= 0; i--) {
        Size p = x->parent[i] < 0 ? n : x->parent[i];
        next[i] = head[p], head[p] = (int32_t)i;
    }
    for (Size p = 0; p < n; p++) {
        int32_t most = head[p], before = -1, last = -1;
        for (int32_t i = head[p], left = -1; i >= 0; left = i, i = next[i]) {
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
    Size top = 0;
    for (int32_t root = head[n]; root >= 0; root = next[root]) {
        stack[top++] = root;
        while (top) {
            int32_t i = stack[top - 1];
            if (head[i] >= 0) {
                stack[top++] = head[i];
                head[i] = next[head[i]];
            } else {
                x->post[N++] = i;
                top--;
            }
        }
    }
    for (Size i = 0; i < n; i++)
        x->place[x->post[i]] = (int32_t)i;
}

/* Whether a front of k columns in all may store a part of zeros (the rule of CHOLMOD; Chen, Davis,
 * Hager & Rajamanickam 2008). */
int joined(double k, double zeros)
{
    return k <= 4 || (k <= 16 && zeros < 0.8) || (k <= 48 && zeros < 0.1) || zeros < 0.05;
}

/* Write the first pivots and the numbers of rows of fronts; returns how many there are. Counts and
 * parents are in the new order. */
Size elimination_fronts(Size n, const int32_t *parent, const int32_t *count, int32_t *begin,
                        int32_t *rows, double *zeros)
{
    Size N = 0;
    for (Size j = 0; j < n; j++) {
        if (j == 0 || parent[j - 1] != j || count[j - 1] != count[j] + 1)
            begin[N] = (int32_t)j, rows[N] = count[j], zeros[N++] = 0;
        int last = j + 1 == n || parent[j] != j + 1 || count[j] != count[j + 1] + 1;
        while (last && N > 1) {
            Size own = begin[N - 1], before = begin[N - 2], up = parent[own - 1];
            double k = (double)(j + 1 - before), left = (double)(own - before);
            double f = left + rows[N - 1];
            double more = zeros[N - 1] + zeros[N - 2] + left * (f - rows[N - 2]);
            if (up < own || up > j || !joined(k, more / (k * f - 0.5 * k * k)))
                break;
            N--;
            zeros[N - 1] = more, rows[N - 1] = (int32_t)f;
        }
    }
    begin[N] = (int32_t)n;
    return N;
}

/* Columns below the diagonal from rows left of it, in the new order; `down` has room for n + 2. */
void elimination_turned(const Elimination *x, int64_t *down, int32_t *below)
{
    memset(down, 0, (size_t)(x->n + 2) * sizeof *down);
    for (Size i = 0; i < x->n; i++)
        for (int64_t e = x->first[i]; e < x->first[i + 1]; e++)
            down[x->place[x->columns[e]] + 2]++;
    for (Size i = 0; i < x->n; i++)
        down[i + 2] += down[i + 1];
    for (Size i = 0; i < x->n; i++)
        for (int64_t e = x->first[i]; e < x->first[i + 1]; e++)
            below[down[x->place[x->columns[e]] + 1]++] = x->place[i];
}

int by_number(const void *a, const void *b)
{
    int32_t x = *(const int32_t *)a, y = *(const int32_t *)b;
    return (x > y) - (x < y);
}

/* Fronts of the renumbered matrix with their rows; `below` holds, column by column from `down` on,
 * rows below the diagonal. Returns the multiplications; `stack` and `most` as in `Fronts`. */
double elimination_rows(Size N, const int32_t *begin, const int64_t *down, const int32_t *below,
                        const int64_t *row_at, int32_t *rows, int64_t *factor_at, int32_t *children,
                        int32_t *mark, int32_t *front_of, int32_t *lists, Size *stack, Size *most)
{
    int32_t *head = lists, *next = lists + N;
    double work = 0;
    Size top = 0;
    *stack = *most = 0;
    factor_at[0] = 0;
    for (Size s = 0; s < N; s++) {
        head[s] = -1, children[s] = 0;
        for (int32_t j = begin[s]; j < begin[s + 1]; j++)
            front_of[j] = (int32_t)s, mark[j] = -1;
    }
    for (Size s = 0; s < N; s++) {
        int32_t end = begin[s + 1], *own = rows + row_at[s];
        Size f = 0, k = end - begin[s], taken = 0;
        for (int32_t j = begin[s]; j < end; j++)
            own[f++] = j;
        for (int32_t j = begin[s]; j < end; j++)
            for (int64_t e = down[j]; e < down[j + 1]; e++)
                if (below[e] >= end && mark[below[e]] != s)
                    mark[below[e]] = (int32_t)s, own[f++] = below[e];
        for (int32_t c = head[s]; c >= 0; c = next[c]) {
            Size pivots = begin[c + 1] - begin[c], size = row_at[c + 1] - row_at[c] - pivots;
            taken += size * size;
            children[s]++;
            for (int64_t e = row_at[c] + pivots; e < row_at[c + 1]; e++)
                if (rows[e] >= end && mark[rows[e]] != s)
                    mark[rows[e]] = (int32_t)s, own[f++] = rows[e];
        }
        qsort(own + k, (size_t)(f - k), sizeof *own, by_number);
        if (f > k) {
            int32_t up = front_of[own[k]];
            next[s] = head[up], head[up] = (int32_t)s;
        }
        Size u = f - k;
        *stack = top + u * u > *stack ? top + u * u : *stack;
        top += u * u - taken;
        *most = f > *most ? f : *most;
        factor_at[s + 1] = factor_at[s] + f * k;
        for (Size j = 0; j < k; j++)
            work += 0.5 * (double)(f - j) * (double)(f - j);
    }
    return work;
}

/* An elimination order, and the fronts in it (`Fronts`), with the multiplications that they take. */
struct FoundFronts {
    std::vector<int32_t> order, begin, rows, children;
    std::vector<int64_t> row_at, factor_at;
    Size stack, most;
    double work;
};

/* The fronts of a symmetric matrix of n unknowns from its entries left of the diagonal. */
FoundFronts fronts_found(Size n, const int64_t *first, const int32_t *columns, Size n_columns)
{
    size_t w = (size_t)n + 1;
    std::vector<double> zeros(w);
    std::vector<int64_t> down(w + 1);
    std::vector<int32_t> room(13 * w + (size_t)n_columns);
    int32_t *p = room.data(), *begin = p + 9 * w, *size = begin + w, *parent = size + w;
    int32_t *count = parent + w, *below = count + w;
    Elimination x = {n,         p,         p + w,    p + 2 * w, p + 3 * w, first, columns,
                     p + 4 * w, p + 5 * w, p + 7 * w};
    elimination_parents(&x);
    elimination_counts(&x);
    elimination_postorder(&x);
    for (Size i = 0; i < n; i++) {
        int32_t up = x.parent[x.post[i]];
        parent[i] = up < 0 ? -1 : x.place[up], count[i] = x.count[x.post[i]];
    }
    size_t N = (size_t)elimination_fronts(n, parent, count, begin, size, zeros.data());
    FoundFronts to;
    to.order.assign(x.post, x.post + n), to.begin.assign(begin, begin + N + 1);
    to.children.resize(N), to.row_at.resize(N + 1), to.factor_at.resize(N + 1);
    for (size_t s = 0; s < N; s++)
        to.row_at[s + 1] = to.row_at[s] + size[s];
    to.rows.resize((size_t)to.row_at[N]);
    elimination_turned(&x, down.data(), below);
    to.work = elimination_rows((Size)N, begin, down.data(), below, to.row_at.data(), to.rows.data(),
                               to.factor_at.data(), to.children.data(), x.mark, x.place, x.head,
                               &to.stack, &to.most);
    return to;
}
