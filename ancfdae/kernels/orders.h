/* Orders of the unknowns of a saddle-point matrix [K, B^T; B, 0] with a narrow band
 * (`numerics/orders.py`).
 *
 * The graph of the coordinates is that of K + B^T B, K with a symmetric pattern. Patterns are
 * compressed sparse rows: where rows begin, and columns.
 */

struct Graph {
    Size n, m;
    const int32_t *first_K, *columns_K, *first_B, *columns_B;
    int32_t *first_T, *rows_T;       /* B^T */
    int32_t *degree, *stamp, *seeds; /* n each; a stamp tells for whom a coordinate was met */
};

void graph_transposed(Graph *g)
{
    int32_t *first = g->first_T;
    memset(first, 0, (size_t)(g->n + 1) * sizeof *first);
    for (int32_t k = 0; k < g->first_B[g->m]; k++)
        first[g->columns_B[k] + 1]++;
    for (Size i = 0; i < g->n; i++)
        first[i + 1] += first[i];
    for (Size r = 0; r < g->m; r++)
        for (int32_t k = g->first_B[r]; k < g->first_B[r + 1]; k++)
            g->rows_T[first[g->columns_B[k]]++] = (int32_t)r;
    memmove(first + 1, first, (size_t)g->n * sizeof *first);
    first[0] = 0;
}

/* Write the neighbours of coordinate i that do not bear the mark, and mark them; their number. */
Size graph_met(Graph *g, Size i, int32_t mark, int32_t *out)
{
    Size count = 0;
    const int32_t *columns = g->columns_K + g->first_K[i];
    Size size = g->first_K[i + 1] - g->first_K[i];
    for (int32_t k = g->first_T[i] - 1; k < g->first_T[i + 1];) {
        for (Size j = 0; j < size; j++)
            if (g->stamp[columns[j]] != mark) {
                g->stamp[columns[j]] = mark;
                out[count++] = columns[j];
            }
        if (++k < g->first_T[i + 1]) {
            int32_t r = g->rows_T[k];
            columns = g->columns_B + g->first_B[r], size = g->first_B[r + 1] - g->first_B[r];
        }
    }
    return count;
}

/* Reverse Cuthill and McKee: from a coordinate of least degree, the neighbours of each by rising
 * degree. */
void graph_ordered(Graph *g, int32_t *order)
{
    Size n = g->n, N = 0;
    for (Size i = 0; i < n; i++)
        g->stamp[i] = -1;
    for (Size i = 0; i < n; i++)
        g->degree[i] = (int32_t)graph_met(g, i, (int32_t)i, order);
    /* Seeds by rising degree, counted; the order has room for the counts. */
    memset(order, 0, (size_t)(n + 1) * sizeof *order);
    for (Size i = 0; i < n; i++)
        order[g->degree[i]]++;
    for (Size k = 1; k <= n; k++)
        order[k] += order[k - 1];
    for (Size i = n - 1; i >= 0; i--)
        g->seeds[--order[g->degree[i]]] = (int32_t)i;
    for (Size i = 0; i < n; i++)
        g->stamp[i] = -1;
    for (Size s = 0, next = 0; s < n; s++) {
        if (g->stamp[g->seeds[s]] == 0)
            continue;
        g->stamp[g->seeds[s]] = 0;
        order[N++] = g->seeds[s];
        for (; next < N; next++) {
            int32_t *met = order + N;
            Size count = graph_met(g, order[next], 0, met);
            for (Size k = 1; k < count; k++) {
                int32_t own = met[k];
                Size at = k;
                for (; at > 0 && (g->degree[met[at - 1]] > g->degree[own] ||
                                  (g->degree[met[at - 1]] == g->degree[own] && met[at - 1] > own));
                     at--)
                    met[at] = met[at - 1];
                met[at] = own;
            }
            N += count;
        }
    }
    for (Size i = 0; i < n / 2; i++) {
        int32_t own = order[i];
        order[i] = order[n - 1 - i];
        order[n - 1 - i] = own;
    }
}

/* Insert each multiplier behind the last of its coordinates: the whole order, and in `place` where
 * each unknown stands. Returns the work of L D L^T in the envelope, and the half-width. */
double graph_completed(const Graph *g, const int32_t *coordinates, int64_t *order, int32_t *place,
                       int32_t *room, Size *half)
{
    Size n = g->n, m = g->m, N = 0;
    int32_t *after = room, *next = room + n; /* The first multiplier there, and the one behind. */
    double work = 0;
    for (Size i = 0; i < n; i++)
        place[coordinates[i]] = (int32_t)i, after[i] = -1;
    for (Size r = m - 1; r >= 0; r--) {
        int32_t last = 0;
        for (int32_t k = g->first_B[r]; k < g->first_B[r + 1]; k++)
            last = place[g->columns_B[k]] > last ? place[g->columns_B[k]] : last;
        next[r] = n ? after[last] : -1;
        if (n)
            after[last] = (int32_t)r;
    }
    for (Size i = 0; i < n; i++) {
        order[N++] = coordinates[i];
        for (int32_t r = after[i]; r >= 0; r = next[r])
            order[N++] = n + r;
    }
    for (Size i = 0; i < N; i++)
        place[order[i]] = (int32_t)i;
    Size end = 0;
    *half = 0;
    for (Size i = 0; i < N; i++) {
        int64_t own = order[i];
        Size far = i;
        if (own < n) {
            for (int32_t k = g->first_K[own]; k < g->first_K[own + 1]; k++)
                far = place[g->columns_K[k]] > far ? place[g->columns_K[k]] : far;
            for (int32_t k = g->first_T[own]; k < g->first_T[own + 1]; k++)
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
void graph_narrow(Graph *g, int32_t *room, int64_t *order, int64_t *other)
{
    Size n = g->n, m = g->m, half, own_half;
    g->first_T = room, g->degree = room + n + 1, g->stamp = g->degree + n;
    g->seeds = g->stamp + n;
    int32_t *place = g->seeds + n, *lists = place + n + m, *coordinates = lists + n + m;
    g->rows_T = coordinates + n + 1;
    graph_transposed(g);
    graph_ordered(g, coordinates);
    double work = graph_completed(g, coordinates, order, place, lists, &half);
    for (Size i = 0; i < n; i++)
        coordinates[i] = (int32_t)i;
    if (graph_completed(g, coordinates, other, place, lists, &own_half) < work && own_half <= half)
        memcpy(order, other, (size_t)(n + m) * sizeof *order);
}
