/* Orders of the unknowns of a saddle-point matrix [K, B^T; B, 0] with a narrow band
 * (`numerics/orders.py`).
 *
 * The graph of the coordinates is that of K + B^T B, K with a symmetric pattern. Patterns are
 * compressed sparse rows: where rows begin, and columns.
 */

typedef struct {
    npy_intp n, m;
    const npy_int32 *first_K, *columns_K, *first_B, *columns_B;
    npy_int32 *first_T, *rows_T;       /* B^T */
    npy_int32 *degree, *stamp, *seeds; /* n each; a stamp tells for whom a coordinate was met */
} graph;

static void graph_transposed(graph *g)
{
    npy_int32 *first = g->first_T;
    memset(first, 0, (size_t)(g->n + 1) * sizeof *first);
    for (npy_int32 k = 0; k < g->first_B[g->m]; k++)
        first[g->columns_B[k] + 1]++;
    for (npy_intp i = 0; i < g->n; i++)
        first[i + 1] += first[i];
    for (npy_intp r = 0; r < g->m; r++)
        for (npy_int32 k = g->first_B[r]; k < g->first_B[r + 1]; k++)
            g->rows_T[first[g->columns_B[k]]++] = (npy_int32)r;
    memmove(first + 1, first, (size_t)g->n * sizeof *first);
    first[0] = 0;
}

/* Write the neighbours of coordinate i that do not bear the mark, and mark them; their number. */
static npy_intp graph_met(graph *g, npy_intp i, npy_int32 mark, npy_int32 *out)
{
    npy_intp count = 0;
    const npy_int32 *columns = g->columns_K + g->first_K[i];
    npy_intp size = g->first_K[i + 1] - g->first_K[i];
    for (npy_int32 k = g->first_T[i] - 1; k < g->first_T[i + 1];) {
        for (npy_intp j = 0; j < size; j++)
            if (g->stamp[columns[j]] != mark) {
                g->stamp[columns[j]] = mark;
                out[count++] = columns[j];
            }
        if (++k < g->first_T[i + 1]) {
            npy_int32 r = g->rows_T[k];
            columns = g->columns_B + g->first_B[r], size = g->first_B[r + 1] - g->first_B[r];
        }
    }
    return count;
}

/* Reverse Cuthill and McKee: from a coordinate of least degree, the neighbours of each by rising
 * degree. */
static void graph_ordered(graph *g, npy_int32 *order)
{
    npy_intp n = g->n, N = 0;
    for (npy_intp i = 0; i < n; i++)
        g->stamp[i] = -1;
    for (npy_intp i = 0; i < n; i++)
        g->degree[i] = (npy_int32)graph_met(g, i, (npy_int32)i, order);
    /* Seeds by rising degree, counted; the order has room for the counts. */
    memset(order, 0, (size_t)(n + 1) * sizeof *order);
    for (npy_intp i = 0; i < n; i++)
        order[g->degree[i]]++;
    for (npy_intp k = 1; k <= n; k++)
        order[k] += order[k - 1];
    for (npy_intp i = n - 1; i >= 0; i--)
        g->seeds[--order[g->degree[i]]] = (npy_int32)i;
    for (npy_intp i = 0; i < n; i++)
        g->stamp[i] = -1;
    for (npy_intp s = 0, next = 0; s < n; s++) {
        if (g->stamp[g->seeds[s]] == 0)
            continue;
        g->stamp[g->seeds[s]] = 0;
        order[N++] = g->seeds[s];
        for (; next < N; next++) {
            npy_int32 *met = order + N;
            npy_intp count = graph_met(g, order[next], 0, met);
            for (npy_intp k = 1; k < count; k++) {
                npy_int32 own = met[k];
                npy_intp at = k;
                for (; at > 0 && (g->degree[met[at - 1]] > g->degree[own] ||
                                  (g->degree[met[at - 1]] == g->degree[own] && met[at - 1] > own));
                     at--)
                    met[at] = met[at - 1];
                met[at] = own;
            }
            N += count;
        }
    }
    for (npy_intp i = 0; i < n / 2; i++) {
        npy_int32 own = order[i];
        order[i] = order[n - 1 - i];
        order[n - 1 - i] = own;
    }
}

/* Insert each multiplier behind the last of its coordinates: the whole order, and in `place` where
 * each unknown stands. Returns the work of L D L^T in the envelope, and the half-width. */
static double graph_completed(const graph *g, const npy_int32 *coordinates, npy_int64 *order,
                              npy_int32 *place, npy_int32 *room, npy_intp *half)
{
    npy_intp n = g->n, m = g->m, N = 0;
    npy_int32 *after = room, *next = room + n; /* The first multiplier there, and the one behind. */
    double work = 0;
    for (npy_intp i = 0; i < n; i++)
        place[coordinates[i]] = (npy_int32)i, after[i] = -1;
    for (npy_intp r = m - 1; r >= 0; r--) {
        npy_int32 last = 0;
        for (npy_int32 k = g->first_B[r]; k < g->first_B[r + 1]; k++)
            last = place[g->columns_B[k]] > last ? place[g->columns_B[k]] : last;
        next[r] = n ? after[last] : -1;
        if (n)
            after[last] = (npy_int32)r;
    }
    for (npy_intp i = 0; i < n; i++) {
        order[N++] = coordinates[i];
        for (npy_int32 r = after[i]; r >= 0; r = next[r])
            order[N++] = n + r;
    }
    for (npy_intp i = 0; i < N; i++)
        place[order[i]] = (npy_int32)i;
    npy_intp end = 0;
    *half = 0;
    for (npy_intp i = 0; i < N; i++) {
        npy_int64 own = order[i];
        npy_intp far = i;
        if (own < n) {
            for (npy_int32 k = g->first_K[own]; k < g->first_K[own + 1]; k++)
                far = place[g->columns_K[k]] > far ? place[g->columns_K[k]] : far;
            for (npy_int32 k = g->first_T[own]; k < g->first_T[own + 1]; k++)
                far = place[n + g->rows_T[k]] > far ? place[n + g->rows_T[k]] : far;
        }
        *half = far - i > *half ? far - i : *half;
        end = far > end ? far : end;
        work += (double)(end - i + 1) * (double)(end - i + 1);
    }
    return work;
}

/* The better of the scene's own order and that of Cuthill and McKee; `room` has 8 (n + m) + 8
 * numbers and one for each value of B. */
static void graph_narrow(graph *g, npy_int32 *room, npy_int64 *order, npy_int64 *other)
{
    npy_intp n = g->n, m = g->m, half, own_half;
    g->first_T = room, g->degree = room + n + 1, g->stamp = g->degree + n;
    g->seeds = g->stamp + n;
    npy_int32 *place = g->seeds + n, *lists = place + n + m, *coordinates = lists + n + m;
    g->rows_T = coordinates + n + 1;
    graph_transposed(g);
    graph_ordered(g, coordinates);
    double work = graph_completed(g, coordinates, order, place, lists, &half);
    for (npy_intp i = 0; i < n; i++)
        coordinates[i] = (npy_int32)i;
    if (graph_completed(g, coordinates, other, place, lists, &own_half) < work && own_half <= half)
        memcpy(order, other, (size_t)(n + m) * sizeof *order);
}
