/* Whether indices that come from outside may be followed: each table says what fits it. */

template <class I> struct Span {
    const I *data;
    Size size;
    const I &operator[](Size i) const { return data[i]; }
};

/* Whether all numbers lie from `least` to `most`: else x - least or most - x has the bit of the
 * sign. Without branches this costs next to nothing. */
template <class I> NOT_INLINE bool within(Span<I> x, Size least, Size most)
{
    using Bits = std::make_unsigned_t<I>;
    const Size high = std::min(most, (Size)std::numeric_limits<I>::max());
    Bits bits = 0;
    for (Size i = 0; i < x.size; i++)
        bits |= ((Bits)x[i] - (Bits)least) | ((Bits)high - (Bits)x[i]);
    return bits >> (8 * sizeof(I) - 1) == 0;
}

/* Whether numbers, `stride` apart, begin at 0, end at `end` and never fall. */
template <class I> NOT_INLINE bool ascending(Span<I> at, Size end, Size stride = 1)
{
    Size count = at.size / stride;
    bool good = count > 0 && at[0] == 0 && at[(count - 1) * stride] == end;
    for (Size i = 1; i < count; i++)
        good &= at[i * stride] >= at[(i - 1) * stride];
    return good;
}

/* Whether operations read numbers that stand before them only. */
bool in_order(Size ahead, Span<int32_t> op, Span<int32_t> a, Span<int32_t> b)
{
    bool good = within(op, 0, OPERATIONS - 1) && a.size == op.size && b.size == op.size;
    for (Size k = 0; good && k < op.size; k++)
        good = a[k] >= 0 && a[k] < ahead + k && b[k] >= 0 && b[k] < ahead + k;
    return good;
}

/* ---- lists of operations (load_plan.h) ------------------------------------------------------ */

/* Whether operation k is a call of one of `count` functions, of numbers before it; the array of calls
 * has `size` numbers. */
bool call_fits(const Operations *p, Size k, Size size, Size count)
{
    Size at = p->a[k], own = p->n_inputs + p->n_constants + k;
    if (at < 0 || at + 2 > size || p->b[k] < 0 || p->b[k] >= count)
        return false;
    const int32_t *call = p->calls + at, *in = call + 2;
    if (call[0] < 0 || call[1] < 0 || (Size)call[0] + call[1] > size - at - 2)
        return false;
    for (Size j = 0; j < call[0]; j++)
        if (in[j] < 0 || in[j] >= own)
            return false;
    for (Size j = call[0]; j < (Size)call[0] + call[1]; j++) {
        Size to = in[j] - own + k;
        if (in[j] != -1 &&
            (to <= k || to >= p->n_operations || p->op[to] != RESULT || p->a[to] != own))
            return false;
    }
    return true;
}

/* Whether operations read numbers that stand before them only, and outputs are numbers. */
bool list_fits(const Operations *p, Size n_calls, Size n_functions)
{
    Size ahead = p->n_inputs + p->n_constants;
    bool good = within(Span<int32_t>{p->op, p->n_operations}, 0, LIST_OPERATIONS - 1) &&
                within(Span<int32_t>{p->outputs, p->n_outputs}, 0, p->n_numbers - 1);
    for (Size k = 0; good && k < p->n_operations; k++)
        good = p->op[k] == CALL ? call_fits(p, k, n_calls, n_functions)
                                : p->a[k] >= 0 && p->a[k] < ahead + k && p->b[k] >= 0 &&
                                      p->b[k] < ahead + k;
    return good;
}

/* ---- constraints (constraint_plan.h) -------------------------------------------------------- */

/* The arrays of a table in the order of `ConstraintTable`. */
enum { CONSTRAINT_ARRAYS = 15 };

struct ConstraintCheck {
    ConstraintTable *p;
    const Span<int32_t> *x;

    int32_t at(Size joint, int item) const { return p->joints[joint * JOINT_ITEMS + item]; }
    /* How many of an item a joint has. */
    Size of(Size joint, int item) const { return at(joint + 1, item) - at(joint, item); }
    /* How many entries of L stand in the rows of a vector at a component. */
    Size entries(Size component, Size components) const
    {
        return p->first[component + components] - p->first[component];
    }
    Size entries_of(Size k) const { return entries(at(k, VECTOR) * p->d, of(k, VECTOR) * p->d); }

    /* Whether the lists of a joint take its numbers, and return as many as they must. */
    bool formula_fits(Size k, const Formula &own) const
    {
        Size n_u = of(k, VECTOR) * p->d, n_z = of(k, INPUT), rows = of(k, ROW), all = n_u + n_z;
        bool good = of(k, PLACE_FORMULA) == rows * entries_of(k);
        for (int which = 0; good && which < FORMULA_LISTS; which++) {
            int curved = which >= OF_CURVATURE, by_inputs = which >= OF_INPUTS && !curved;
            int order = curved ? which - OF_CURVATURE : which % ORDERS;
            Size size = curved ? n_u * n_u : by_inputs ? rows * n_z : which < ORDERS ? rows : rows * n_u;
            good = own.lists[which]->n_inputs == (order + 1) * all + curved * rows &&
                   own.lists[which]->n_outputs == size;
        }
        return good;
    }

    /* Whether everything of a joint lies within it, with as many places as are taken. */
    bool joint_fits(Size k) const
    {
        Size begin = at(k, VECTOR) * p->d, end = at(k + 1, VECTOR) * p->d, linear = 0, products = 0;
        bool good = true;
        for (Size e = at(k, LINEAR); good && e < at(k + 1, LINEAR); e++) {
            good = p->linear_at[e] >= begin && p->linear_at[e] < end;
            linear += good ? entries(p->linear_at[e], 1) : 0;
        }
        for (Size e = at(k, PRODUCT); good && e < at(k + 1, PRODUCT); e++) {
            good = p->i[e] >= begin && p->i[e] <= end - p->d && p->j[e] >= begin &&
                   p->j[e] <= end - p->d;
            products += good ? entries(p->i[e], p->d) + entries(p->j[e], p->d) : 0;
        }
        for (Size e = at(k, MOVING); good && e < at(k + 1, MOVING); e++)
            good = p->moving_part[e] >= at(k, PART) && p->moving_part[e] < at(k + 1, PART);
        return good && linear == of(k, PLACE_LINEAR) && products == of(k, PLACE_PRODUCT) &&
               (p->formula[k] >= 0 ? formula_fits(k, p->formulas[p->formula[k]])
                                   : of(k, INPUT) == 0 && of(k, PLACE_FORMULA) == 0);
    }

    bool tables_fit() const
    {
        Size n_U = x[1].size - 1;
        const Size ends[JOINT_ITEMS] = {n_U / p->d, p->n_a, p->n_s,    p->n_lam,  p->n_parts,
                                        p->n_moving, p->n_z, x[8].size, x[9].size, x[10].size};
        bool good = n_U % p->d == 0 && p->n_parts > 0 && x[2].size == p->n_l &&
                    x[0].size == (p->n_joints + 1) * JOINT_ITEMS;
        for (int i = 0; good && i < JOINT_ITEMS; i++)
            good = i == PART ? at(0, PART) == 1 && at(p->n_joints, PART) == p->n_parts
                             : ascending(Span<int32_t>{p->joints + i, x[0].size}, ends[i], JOINT_ITEMS);
        for (Size k = 0; good && k < p->n_joints; k++)
            good = of(k, PART) >= 0;
        return good && ascending(x[1], p->n_l) && within(x[2], 0, p->n_q - 1) &&
               x[4].size == p->n_a && x[6].size == p->n_s && x[7].size == p->n_s &&
               within(x[3], 0, p->n_lam - 1) && within(x[5], 0, p->n_lam - 1) &&
               within(x[8], 0, p->n_values - 1) && within(x[9], 0, p->n_values - 1) &&
               within(x[10], 0, p->n_values - 1) && x[11].size == p->n_joints &&
               within(x[11], -1, p->n_formulas - 1) && x[14].size == p->n_moving &&
               x[13].size == p->n_moving && within(x[13], 0, p->n_c - 1) &&
               within(x[12], 0, p->n_curved - 1);
    }

    /* Fill in what follows from the arrays; whether all of them fit. */
    bool fits()
    {
        Size curved = 0;
        bool good = tables_fit();
        for (Size k = 0; good && k < p->n_joints; k++) {
            p->most = std::max(p->most, of(k, VECTOR) * p->d);
            good = joint_fits(k);
        }
        for (Size e = 0; good && e < p->n_s; e++)
            for (int axis = 0; axis < p->d; axis++)
                curved += 2 * entries(p->i[e] + axis, 1) * entries(p->j[e] + axis, 1);
        p->curved_formula = p->curved + std::min(curved, x[12].size);
        for (Size k = 0; good && k < p->n_joints; k++)
            curved += p->formula[k] < 0 ? 0 : entries_of(k) * entries_of(k);
        return good && curved == x[12].size;
    }
};

/* ---- loads (load_plan.h) -------------------------------------------------------------------- */

/* Whether indices are those of a load whose L has n_l entries, with a place for each of a tangent. */
bool load_fits(const LoadTable *p, Size n_l, Span<int32_t> first, Span<int32_t> columns,
               Span<int32_t> output, Span<int32_t> places, Span<int32_t> gates)
{
    Size entries = 0;
    bool good = first.size == p->n_copies * p->n_U + 1 && ascending(first, n_l) &&
                columns.size == n_l && within(columns, 0, p->n_q - 1) && output.size == p->n_U &&
                in_order(p->n_numbers - p->n_operations, {p->op, p->n_operations},
                         {p->a, p->n_operations}, {p->b, p->n_operations}) &&
                within(output, 0, p->n_numbers - 1) && within(places, 0, p->n_values - 1) &&
                within(gates, 0, p->n_operations - 1);
    for (Size copy = 0; good && copy < p->n_copies; copy++) {
        Size of_copy = first[(copy + 1) * p->n_U] - first[copy * p->n_U];
        entries += of_copy * of_copy;
    }
    return good && places.size == entries;
}

/* ---- matrices ------------------------------------------------------------------------------- */

/* Whether rows are in order, hold all entries, and those in a matrix with `n_columns` columns. */
bool csr_fits(Span<int32_t> first, Span<int32_t> columns, Size values, Size n_columns)
{
    return ascending(first, columns.size) && values == columns.size &&
           within(columns, 0, n_columns - 1);
}

/* Whether columns of an envelope (symmetric.h) begin at their diagonal and end in order. */
bool envelope_fits(Span<int32_t> first)
{
    Size n = first.size - 1, last = 0;
    bool good = n >= 0 && first[0] == 0;
    for (Size k = 0; good && k < n; k++) {
        Size height = (Size)first[k + 1] - first[k], end = k + height;
        good = height >= 1 && end >= last && end <= n;
        last = end;
    }
    return good;
}

/* Whether entries stand left of the diagonal, row by row. */
bool lower_fits(Span<int64_t> first, Span<int32_t> columns)
{
    Size n = first.size - 1;
    bool good = n < std::numeric_limits<int32_t>::max() && ascending(first, columns.size);
    for (Size i = 0; good && i < n; i++)
        for (int64_t e = first[i]; good && e < first[i + 1]; e++)
            good = columns[e] >= 0 && columns[e] < i;
    return good;
}

/* Whether fronts are those of one matrix: the rows of each hold those of its columns and of the
 * updates that it takes. Lengths of arrays must be right. */
bool fronts_fit(const Fronts *x, Size rows, Size column_rows)
{
    bool good = x->most <= x->n && x->begin[0] == 0 && x->begin[x->count] == x->n &&
                x->row_at[0] == 0 && x->row_at[x->count] == rows && x->factor_at[0] == 0 &&
                within(Span<int32_t>{x->rows, rows}, 0, x->n - 1) &&
                ascending(Span<int64_t>{x->column_at, x->n + 1}, column_rows) &&
                within(Span<int32_t>{x->column_rows, column_rows}, 0, x->n - 1);
    std::vector<int32_t> mark((size_t)x->n, -1), updates((size_t)x->count + 1);
    Size waiting = 0, top = 0;
    for (Size j = 0; good && j < x->n; j++)
        good = x->column_at[j + 1] > x->column_at[j] && x->column_rows[x->column_at[j]] == j;
    auto below = [x](Size s) {
        return x->row_at[s + 1] - x->row_at[s] - (x->begin[s + 1] - x->begin[s]);
    };
    auto marked = [&](int32_t row, Size s) { return mark[(size_t)row] == s; };
    for (Size s = 0; good && s < x->count; s++) {
        Size k = x->begin[s + 1] - x->begin[s], f = x->row_at[s + 1] - x->row_at[s], u = f - k;
        good = k > 0 && u >= 0 && f <= x->most && x->children[s] >= 0 &&
               x->children[s] <= waiting && x->row_at[s + 1] <= rows && x->begin[s + 1] <= x->n &&
               x->factor_at[s + 1] == x->factor_at[s] + f * k && top + u * u <= x->stack;
        for (Size i = 0; good && i < f; i++) {
            int32_t row = x->rows[x->row_at[s] + i];
            good = i >= k || row == x->begin[s] + i;
            mark[(size_t)row] = (int32_t)s;
        }
        for (int64_t e = x->column_at[good ? x->begin[s] : 0];
             good && e < x->column_at[x->begin[s + 1]]; e++)
            good = marked(x->column_rows[e], s);
        for (int32_t c = 0; good && c < x->children[s]; c++) {
            Size own = updates[(size_t)--waiting];
            top -= below(own) * below(own);
            for (int64_t e = x->row_at[own + 1] - below(own); good && e < x->row_at[own + 1]; e++)
                good = marked(x->rows[e], s);
        }
        if (good)
            top += u * u, updates[(size_t)waiting++] = (int32_t)s;
    }
    return good;
}
