/* What Python calls of vectors and matrices. */

/* ---- vectors -------------------------------------------------------------------------------- */

/* Real or complex numbers as real ones, `stride` apart. */
struct Parts {
    std::variant<Array<double>, Array<Complex>> of;
    const double *data;
    Size size;
    int stride;

    explicit Parts(PyObject *x)
        : of(is_complex(x) ? decltype(of)(Array<Complex>(x)) : decltype(of)(Array<double>(x)))
    {
        std::visit([this](auto &own) { data = (const double *)own.data, size = own.size; }, of);
        stride = 1 + (int)of.index();
    }
};

/* Sum over pairs of sqrt(sum of weights x^2) of the real parts. */
double py_norm(Rest<Ref> pairs)
{
    double total = 0;
    must(!pairs.empty() && pairs.size() % 2 == 0, "norm takes pairs of arguments");
    for (size_t k = 0; k < pairs.size(); k += 2) {
        Parts x(pairs[k].get());
        Array<double> weights(pairs[k + 1].get());
        must(x.size == weights.size, "there must be one weight for each number");
        double sum = 0;
        for (Size i = 0; i < x.size; i++)
            sum += weights.data[i] * x.data[i * x.stride] * x.data[i * x.stride];
        total += sqrt(sum);
    }
    return total;
}

bool py_finite(Parts x)
{
    Size size = x.size * x.stride, i = 0;
    /* Zero times what is not finite is not a number; sums apart do not wait for each other. */
    double sum[8] = {0};
    for (; i + 8 <= size; i += 8)
        for (int k = 0; k < 8; k++)
            sum[k] += 0 * x.data[i + k];
    for (; i < size; i++)
        sum[0] += 0 * x.data[i];
    for (int k = 1; k < 8; k++)
        sum[0] += sum[k];
    return sum[0] == 0;
}

/* ---- sparse rows ---------------------------------------------------------------------------- */

using Indices = Array<int32_t, 1>;

/* Rows must be in order, hold all entries, and those in a matrix with `n_columns` columns. */
void check_csr(const Indices &first, const Indices &columns, Size values, Size n_columns)
{
    must(ascending(first.data, first.size, 1, columns.size) && values == columns.size &&
             within(columns, 0, n_columns - 1),
         "these are not the compressed sparse rows of a matrix of this size");
}

/* M x for rows of x, or M^T x; `transposed` is the number of columns of M. */
template <class T>
Array<T> py_csr_rows(Indices first, Indices columns, Array<T, 1> values, Array<T, 1> x,
                     std::optional<Size> transposed)
{
    Size n = first.size - 1, k = x.rows(1), width = transposed ? *transposed : x.length(-1);
    must(!transposed || x.ends({n}), "x must have one number for each row of the matrix");
    check_csr(first, columns, values.size, width);
    auto out = zeros_like<T>(x, 1, {transposed ? width : n});
    if (transposed)
        csr_rows_transposed<T>(n, first.data, columns.data, values.data, k, x.data, 1, width,
                               out.data);
    else
        csr_rows<T>(n, first.data, columns.data, values.data, k, width, x.data,
                    room_for<T>(k > 1 ? 8 * width : 0).get(), 1, n, out.data);
    return out;
}

Array<int64_t> py_narrow_order(Indices first_K, Indices columns_K, Indices first_B,
                               Indices columns_B)
{
    Size n = first_K.size - 1, m = first_B.size - 1, size = n + m;
    check_csr(first_K, columns_K, columns_K.size, n);
    check_csr(first_B, columns_B, columns_B.size, n);
    must(size <= NPY_MAX_INT32 / 8 && (m == 0 || n > 0),
         "there must be coordinates, and indices of 32 bits for them");
    auto room = room_for<int32_t>(8 * size + 8 + columns_B.size);
    auto other = room_for<int64_t>(size);
    auto order = zeros<int64_t>({size});
    Graph g = {n,  m, first_K.data, columns_K.data, first_B.data, columns_B.data, {}, {}, {},
               {}, {}};
    graph_narrow(&g, room.get(), order.data, other.get());
    return order;
}

/* ---- bands ---------------------------------------------------------------------------------- */

/* A LAPACK routine of SciPy, loaded by Python, which limits its threads. The capsule that holds it is
 * named after its arguments: they must begin so. */
void *lapack(const char *name, const char *beginning)
{
    Ref module = made(PyImport_ImportModule("ancfdae.numerics.threads"));
    Ref routines = made(PyObject_CallMethod(module.get(), "lapack", nullptr));
    Ref capsule = made(PyMapping_GetItemString(routines.get(), name));
    const char *arguments = PyCapsule_GetName(capsule.get());
    if (!arguments || strncmp(arguments, beginning, strlen(beginning)) != 0) {
        if (!PyErr_Occurred())
            PyErr_Format(PyExc_ImportError,
                         "%s of this SciPy is not LAPACK's with 32-bit integers, but %s", name,
                         arguments ? arguments : "nameless");
        throw Failed();
    }
    return PyCapsule_GetPointer(capsule.get(), arguments);
}

/* The same, kept once it is found. */
template <class T> Gbtrf<T> gbtrf_of()
{
    static auto found = (Gbtrf<T>)lapack(std::is_same<T, double>::value ? "dgbtrf" : "zgbtrf",
                                         "void (int *, int *, int *, int *, ");
    return found;
}

template <class T> Gbtrs<T> gbtrs_of()
{
    static auto found = (Gbtrs<T>)lapack(std::is_same<T, double>::value ? "dgbtrs" : "zgbtrs",
                                         "void (char *, int *, int *, int *, int *, ");
    return found;
}

const Size MOST_HALF = (INT_MAX - 1) / 3;

/* The factors, (n, 3 half + 1), pivots, what B is scaled by, and info. */
template <class T>
std::tuple<Array<T>, Array<int32_t>, double, int>
py_band_factor(Array<T> K, Array<T> B, Array<double> factors, Array<int64_t> flat, Size n,
               Size half)
{
    must(n <= INT_MAX && half <= MOST_HALF, "a number is negative or too large");
    auto lu = zeros<T>({n, 3 * half + 1});
    auto pivots = zeros<int32_t>({n});
    Size size = K.size + 2 * B.size;
    double of_B = 1;
    must(flat.size == size && factors.size == size && within(flat, 0, lu.size - 1),
         "there must be a place in the band and a factor for each value");
    int info = band_factor<T>(gbtrf_of<T>(), (int)n, (int)half, K.size, B.size, K.data, B.data,
                              factors.data, flat.data, lu.data, pivots.data, &of_B);
    return {std::move(lu), std::move(pivots), of_B, info};
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

/* Solutions for rows of right sides R by a matrix of scalars T. */
template <class T, class R>
Array<R> py_band_solve(Array<T, 2> lu, Array<int32_t> pivots, Size half, Array<int64_t> order,
                       Array<double> scale, Array<R, 1> right, bool transposed)
{
    constexpr int parts = sizeof(R) / sizeof(T);
    Size n = order.size, rows = right.rows(1);
    must(half <= MOST_HALF && n <= INT_MAX && lu.has({n, 3 * half + 1}) && pivots.size == n &&
             within(pivots, 1, n) && within(order, 0, n - 1) && scale.size == n,
         "factors, pivots, order and scale must be those of one band matrix");
    must(right.ends({n}) && rows <= INT_MAX / 2,
         "a right side must have one number for each row of the matrix");
    auto work = room_for<T>(parts * right.size);
    auto out = zeros_like<R>(right, 0, {});
    numbered<T>(rows, n, parts, order.data, scale.data, (const T *)right.data, work.get(), false);
    band_solve<T>(gbtrs_of<T>(), transposed ? 'T' : 'N', (int)n, (int)half, (int)rows * parts,
                  lu.data, pivots.data, work.get());
    numbered<T>(rows, n, parts, order.data, scale.data, work.get(), (T *)out.data, true);
    return out;
}

/* ---- envelopes and fronts ------------------------------------------------------------------- */

/* Columns of an envelope (symmetric.h) must begin at their diagonal and end in order; its size. */
Size envelope_size(const Indices &first)
{
    Size n = first.size - 1, last = 0;
    bool good = first.axes == 1 && n >= 0 && first.data[0] == 0;
    for (Size k = 0; good && k < n; k++) {
        Size height = (Size)first.data[k + 1] - first.data[k], end = k + height;
        good = height >= 1 && end >= last && end <= n;
        last = end;
    }
    must(good, "columns of an envelope begin at their diagonal and end in order");
    return first.data[n];
}

/* A sum of numbers times values, of one size. */
template <class T> using Terms = std::vector<std::tuple<double, Array<T>>>;

/* Add the values `chosen` of a sum, then all of B, at their places among `size` numbers. */
template <class T>
void placed(const Terms<T> &terms, const Array<T> &B, const Indices &chosen, const Indices &places,
            Array<T> &out)
{
    Size n = chosen.size, each = terms.empty() ? -1 : std::get<1>(terms[0]).size;
    must(each >= 0 && places.size == n + B.size && within(chosen, 0, each - 1) &&
             within(places, 0, out.size - 1),
         "there must be terms, and a place in the matrix for each value");
    for (auto &[s, K] : terms) {
        must(K.size == each, "terms must have one size");
        ldl_placed<T>(n, chosen.data, places.data, s, K.data, out.data);
    }
    ldl_placed<T>(B.size, nullptr, places.data + n, 1, B.data, out.data);
}

/* Factors in their envelope, and the pivot that fails. */
template <class T>
std::tuple<Array<T>, int> py_ldl_factor(Terms<T> terms, Array<T> B, Indices chosen, Indices places,
                                        Indices first, Array<double, 1> signs)
{
    auto a = zeros<T>({envelope_size(first)});
    Size n = first.size - 1;
    must(signs.size == n, "there must be a sign for each row");
    placed<T>(terms, B, chosen, places, a);
    auto least = room_for<double>(n);
    int info = ldl_factor<T>(n, first.data, signs.data, a.data, least.get());
    return {std::move(a), info};
}

template <class T, class R>
Array<R> py_ldl_solve(Array<T, 1> factors, Indices first, Array<int64_t, 1> order,
                      Array<R, 1> right)
{
    constexpr int parts = sizeof(R) / sizeof(T);
    Size n = first.size - 1;
    must(factors.size == envelope_size(first) && order.size == n && within(order, 0, n - 1) &&
             right.ends({n}),
         "factors, order and right sides must be those of one matrix");
    auto work = room_for<T>(8 * n);
    auto out = zeros_like<R>(right, 0, {});
    ldl_solve<T>(n, first.data, factors.data, order.data, right.rows(1) * parts, parts,
                 (const T *)right.data, work.get(), (T *)out.data);
    return out;
}

/* The fronts of a symmetric matrix from its entries left of the diagonal, row by row: (order, begin,
 * row_at, rows, factor_at, children, stack, most), and the multiplications of a factorisation. */
using Longs = Array<int64_t, 1>;

/* See `Sides`; without lengths the vectors belong to rigid bodies. */
bool py_keeps_sides(Array<double, 2> q, Array<int64_t, 2> ends, Size d, Maybe<double, 1> lengths,
                    Maybe<double, 1> least)
{
    Size k = q.length(0), n_q = q.length(1), n = ends.length(0), each = ends.length(1);
    must((d == 2 || d == 3) && n_q % d == 0 && within(ends, 0, n_q / d - 1) &&
             (lengths ? each == 4 || each == 2 * (d + 1) : each == d + 1),
         "there must be vectors of the coordinates, of elements or of rigid bodies");
    must(!lengths == !least && (!lengths || (lengths->size == n && least->size == n)),
         "each element has a length and a limit");
    const double *of = data_of(lengths), *limits = data_of(least);
    Unlocked others;
    return d == 2 ? Sides<2>{k, n_q, n, each, q.data, of, limits, ends.data}.kept()
                  : Sides<3>{k, n_q, n, each, q.data, of, limits, ends.data}.kept();
}
using FrontsFound = std::tuple<Array<int32_t>, Array<int32_t>, Array<int64_t>, Array<int32_t>,
                               Array<int64_t>, Array<int32_t>, Size, Size>;
std::tuple<FrontsFound, double> py_eliminate(Longs first, Indices columns)
{
    Size n = first.size - 1, w = n + 1, stack, most;
    bool good = n < NPY_MAX_INT32 && ascending(first.data, first.size, 1, columns.size);
    for (Size i = 0; good && i < n; i++)
        for (int64_t e = first.data[i]; good && e < first.data[i + 1]; e++)
            good = columns.data[e] >= 0 && columns.data[e] < i;
    must(good, "entries must stand left of the diagonal, row by row");
    auto zeros_of = room_for<double>(w);
    auto down = room_for<int64_t>(n + 2);
    auto room = room_for<int32_t>(13 * w + columns.size);
    int32_t *p = room.get(), *begin = p + 9 * w, *size = begin + w, *parent = size + w;
    int32_t *count = parent + w, *below = count + w;
    Elimination x = {n,         p,         p + w,    p + 2 * w, p + 3 * w, first.data, columns.data,
                     p + 4 * w, p + 5 * w, p + 7 * w};
    elimination_parents(&x);
    elimination_counts(&x);
    elimination_postorder(&x);
    for (Size i = 0; i < n; i++) {
        int32_t up = x.parent[x.post[i]];
        parent[i] = up < 0 ? -1 : x.place[up], count[i] = x.count[x.post[i]];
    }
    Size N = elimination_fronts(n, parent, count, begin, size, zeros_of.get());
    auto order = zeros<int32_t>({n}), begins = zeros<int32_t>({N + 1}),
         children = zeros<int32_t>({N});
    auto row_at = zeros<int64_t>({N + 1}), factor_at = zeros<int64_t>({N + 1});
    for (Size s = 0; s < N; s++)
        row_at.data[s + 1] = row_at.data[s] + size[s];
    auto rows = zeros<int32_t>({(Size)row_at.data[N]});
    std::copy(x.post, x.post + n, order.data);
    std::copy(begin, begin + N + 1, begins.data);
    elimination_turned(&x, down.get(), below);
    double work =
        elimination_rows(N, begin, down.get(), below, row_at.data, rows.data, factor_at.data,
                         children.data, x.mark, x.place, x.head, &stack, &most);
    return {FrontsFound{std::move(order), std::move(begins), std::move(row_at), std::move(rows),
                        std::move(factor_at), std::move(children), stack, most},
            work};
}

/* (begin, row_at, rows, factor_at, children, stack, most, column_at, column_rows, signs) of a
 * matrix, checked. */
struct FrontArguments {
    std::tuple<Indices, Longs, Indices, Longs, Indices, Size, Size, Longs, Indices,
               Array<double, 1>>
        of;
    Fronts fronts;

    explicit FrontArguments(PyObject *object) : of(From<decltype(of)>::object(object))
    {
        auto &[begin, row_at, rows, factor_at, children, stack, most, column_at, column_rows,
               signs] = of;
        Size N = children.size, n = signs.size, waiting = 0, top = 0;
        Fronts *x = &fronts;
        *x = {n,
              N,
              most,
              stack,
              begin.data,
              row_at.data,
              rows.data,
              factor_at.data,
              children.data,
              column_at.data,
              column_rows.data,
              signs.data};
        bool good = begin.size == N + 1 && row_at.size == N + 1 && factor_at.size == N + 1 &&
                    most <= n && x->begin[0] == 0 && x->begin[N] == n && x->row_at[0] == 0 &&
                    x->row_at[N] == rows.size && x->factor_at[0] == 0 && within(rows, 0, n - 1) &&
                    ascending(x->column_at, column_at.size, 1, column_rows.size) &&
                    column_at.size == n + 1 && within(column_rows, 0, n - 1);
        auto mark = room_for<int32_t>(n), updates = room_for<int32_t>(N + 1);
        std::fill_n(mark.get(), n, -1);
        for (Size j = 0; good && j < n; j++)
            good = x->column_at[j + 1] > x->column_at[j] && x->column_rows[x->column_at[j]] == j;
        auto below = [x](Size s) {
            return x->row_at[s + 1] - x->row_at[s] - (x->begin[s + 1] - x->begin[s]);
        };
        /* The rows of each front hold those of its columns and of the updates that it takes. */
        for (Size s = 0; good && s < N; s++) {
            Size k = x->begin[s + 1] - x->begin[s], f = x->row_at[s + 1] - x->row_at[s], u = f - k;
            good = k > 0 && u >= 0 && f <= most && x->children[s] >= 0 &&
                   x->children[s] <= waiting && x->row_at[s + 1] <= rows.size &&
                   x->begin[s + 1] <= n && x->factor_at[s + 1] == x->factor_at[s] + f * k &&
                   top + u * u <= stack;
            for (Size i = 0; good && i < f; i++) {
                int32_t row = x->rows[x->row_at[s] + i];
                good = i >= k || row == x->begin[s] + i;
                mark[(size_t)row] = (int32_t)s;
            }
            for (int64_t e = x->column_at[x->begin[s]]; good && e < x->column_at[x->begin[s + 1]];
                 e++)
                good = mark[(size_t)x->column_rows[e]] == s;
            for (int32_t c = 0; good && c < x->children[s]; c++) {
                Size own = updates[(size_t)--waiting];
                top -= below(own) * below(own);
                for (int64_t e = x->row_at[own + 1] - below(own); good && e < x->row_at[own + 1];
                     e++)
                    good = mark[(size_t)x->rows[e]] == s;
            }
            if (good)
                top += u * u, updates[(size_t)waiting++] = (int32_t)s;
        }
        must(good, "these are no fronts of one matrix, or a front lacks rows");
    }
};

/* (scaled values, scale, factors), and the pivot that fails. */
using Factored = std::tuple<Array<double>, Array<double>, Array<double>>;
std::tuple<Factored, Size> fronts_of(const Terms<double> &terms, const Array<double> &B,
                                     const Indices &chosen, const Indices &places,
                                     const Fronts &x, Size *excess)
{
    auto a = zeros<double>({(Size)x.column_at[x.n]}), scale = zeros<double>({x.n});
    auto factors = zeros<double>({(Size)x.factor_at[x.count]});
    auto room = room_for<double>(a.size + x.stack + 5 * x.most);
    auto at = room_for<int32_t>(2 * x.n);
    placed<double>(terms, B, chosen, places, a);
    FrontRoom own = {
        a.data,  scale.data, room.get(), room.get() + a.size, room.get() + a.size + x.stack,
        at.get()};
    Size info;
    info = unlocked([&] { return fronts_factored(&x, &own, factors.data, excess); });
    return {Factored{std::move(a), std::move(scale), std::move(factors)}, info};
}

std::tuple<Factored, Size> py_fronts_factor(Terms<double> terms, Array<double> B, Indices chosen,
                                            Indices places, FrontArguments of)
{
    return fronts_of(terms, B, chosen, places, of.fronts, nullptr);
}

/* By how many more pivots are negative than should be, and the growth, infinite where a pivot
 * vanishes, or has not its sign unless signs are counted. */
std::tuple<Size, double> py_fronts_signs(Terms<double> terms, Array<double> B, Indices chosen,
                                         Indices places, FrontArguments of, bool counted)
{
    const Fronts &x = of.fronts;
    Size excess = 0;
    auto [factored, info] = fronts_of(terms, B, chosen, places, x, counted ? &excess : nullptr);
    auto &[a, scale, factors] = factored;
    if (info)
        return {excess, INFINITY};
    auto sums = room_for<double>(x.n);
    return {excess, fronts_growth(&x, scale.data, factors.data, sums.get())};
}

/* Solutions, and the largest relative residual; right sides are the last axis. Residuals up to
 * `enough`, or a few units of round-off, are not refined. */
template <class R>
std::tuple<Array<R>, double>
py_fronts_solve(std::tuple<Array<double, 1>, Array<double, 1>, Array<double, 1>> factored,
                FrontArguments of, Longs order, Array<R, 1> right, double enough)
{
    constexpr int parts = sizeof(R) / sizeof(double);
    const Fronts &x = of.fronts;
    auto &[a, scale, factors] = factored;
    must(a.size == x.column_at[x.n] && scale.size == x.n && factors.size == x.factor_at[x.count] &&
             order.size == x.n && within(order, 0, x.n - 1) && right.ends({x.n}),
         "factors, order and right sides must be those of one matrix");
    auto work = room_for<double>(12 * x.n + 4 * x.most);
    auto out = zeros_like<R>(right, 0, {});
    double worst;
    worst = unlocked([&] {
        return fronts_solve(fmax(enough, TO_ROUND_OFF), &x, a.data, factors.data, order.data,
                            scale.data, right.rows(1) * parts, parts, (const double *)right.data,
                            work.get(), (double *)out.data);
    });
    return {std::move(out), worst};
}
