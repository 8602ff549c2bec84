/* What Python calls of vectors and matrices. */

/* ---- vectors -------------------------------------------------------------------------------- */

/* Sum over pairs of sqrt(sum of weights x^2) of the real parts. */
double py_norm(Rest<Ref> pairs)
{
    double total = 0;
    must(!pairs.empty() && pairs.size() % 2 == 0, "norm takes pairs of arguments");
    for (size_t k = 0; k < pairs.size(); k += 2) {
        Numbers x(pairs[k].get(), 0);
        Array<double> weights(pairs[k + 1]);
        must(x.size == weights.size, "there must be one weight for each number");
        const double *parts = x.parts();
        double sum = 0;
        for (Size i = 0; i < x.size; i++)
            sum += weights.data[i] * parts[i * x.stride()] * parts[i * x.stride()];
        total += sqrt(sum);
    }
    return total;
}

bool py_finite(Numbers all)
{
    const double *x = all.parts();
    Size size = all.size * all.stride(), i = 0;
    /* Zero times what is not finite is not a number; sums apart do not wait for each other. */
    double sum[8] = {0};
    for (; i + 8 <= size; i += 8)
        for (int k = 0; k < 8; k++)
            sum[k] += 0 * x[i + k];
    for (; i < size; i++)
        sum[0] += 0 * x[i];
    for (int k = 1; k < 8; k++)
        sum[0] += sum[k];
    return sum[0] == 0;
}

/* ---- sparse rows ---------------------------------------------------------------------------- */

void check_csr(const Indices &first, const Indices &columns, Size values, Size n_columns)
{
    must(csr_fits(span_of(first), span_of(columns), values, n_columns),
         "these are not the compressed sparse rows of a matrix of this size");
}

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
    return unlocked([&] {
        return d == 2 ? Sides<2>{k, n_q, n, each, q.data, of, limits, ends.data}.kept()
                      : Sides<3>{k, n_q, n, each, q.data, of, limits, ends.data}.kept();
    });
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

/* The band of n unknowns in an order: places of all values, which numbers multiply. */
struct Band : OfReals {
    static constexpr const char *NAME = "Band";
    using Arguments = std::tuple<Size, Longs, Array<double, 1>, Longs>;
    Arguments of;
    Size half, n, width;

    explicit Band(Arguments arguments) : of(std::move(arguments))
    {
        auto &[all_half, flat, factors, order] = of;
        half = all_half, n = order.size, width = 3 * half + 1;
        must(n <= INT_MAX && half <= (INT_MAX - 1) / 3 && within(order, 0, n - 1) &&
                 factors.size == flat.size && within(flat, 0, n * width - 1),
             "there must be a place in the band and a factor for each value, and an order");
    }
    const Longs &flat() const { return std::get<1>(of); }
    const double *factors() const { return std::get<2>(of).data; }
    const Longs &order() const { return std::get<3>(of); }
};

template <class T>
std::tuple<Array<T>, Array<int32_t>, double, int> py_band_factor(Kept<Band> band, Array<T> K,
                                                                 Array<T> B)
{
    must(band->flat().size == K.size + 2 * B.size, "the band must have a place for each value");
    auto lu = zeros<T>({band->n, band->width});
    auto pivots = zeros<int32_t>({band->n});
    double of_B = 1;
    int info = band_factor<T>(gbtrf_of<T>(), (int)band->n, (int)band->half, K.size, B.size, K.data,
                              B.data, band->factors(), band->flat().data, lu.data, pivots.data,
                              &of_B);
    return {std::move(lu), std::move(pivots), of_B, info};
}

/* Solutions for rows of right sides R by a matrix of scalars T. */
template <class T, class R>
Array<R> py_band_solve(Kept<Band> band, Array<T, 2> lu, Array<int32_t> pivots, Array<double> scale,
                       Array<R, 1> right, bool transposed)
{
    constexpr int parts = sizeof(R) / sizeof(T);
    Size n = band->n, rows = right.rows(1);
    must(lu.has({n, band->width}) && pivots.size == n && within(pivots, 1, n) && scale.size == n &&
             right.ends({n}) && rows <= INT_MAX / 2,
         "factors, pivots, scale and right sides must be those of one band matrix");
    auto work = room_for<T>(parts * right.size);
    auto out = zeros_like<R>(right, 0, {});
    const int64_t *order = band->order().data;
    numbered<T>(rows, n, parts, order, scale.data, (const T *)right.data, work.get(), false);
    band_solve<T>(gbtrs_of<T>(), transposed ? 'T' : 'N', (int)n, (int)band->half, (int)rows * parts,
                  lu.data, pivots.data, work.get());
    numbered<T>(rows, n, parts, order, scale.data, work.get(), (T *)out.data, true);
    return out;
}

/* ---- envelopes and fronts ------------------------------------------------------------------- */

/* A sum of numbers times values, of one size. */
template <class T> using Terms = std::vector<std::tuple<double, Array<T>>>;

/* Where chosen values of K, then all of B, stand among `size` numbers of a lower triangle. */
struct LowerPlaces {
    Indices chosen, places;
    Size least; /* How many values K has at least. */

    LowerPlaces(Indices all_chosen, Indices all_places, Size size)
        : chosen(std::move(all_chosen)), places(std::move(all_places)), least(0)
    {
        for (Size i = 0; i < chosen.size; i++)
            least = std::max(least, (Size)chosen.data[i] + 1);
        must(within(chosen, 0, NPY_MAX_INT32) && within(places, 0, size - 1),
             "there must be a place in the matrix for each value");
    }
    Size of_B() const { return places.size - chosen.size; }

    template <class T> void add(const Terms<T> &terms, const Array<T> &B, Array<T> &out) const
    {
        Size each = terms.empty() ? -1 : std::get<1>(terms[0]).size;
        must(each >= least && of_B() == B.size, "there must be terms, and values for all places");
        for (auto &[s, K] : terms) {
            must(K.size == each, "terms must have one size");
            ldl_placed<T>(chosen.size, chosen.data, places.data, s, K.data, out.data);
        }
        ldl_placed<T>(B.size, nullptr, places.data + chosen.size, 1, B.data, out.data);
    }
};

/* Where columns of an envelope begin (symmetric.h), its places, signs of pivots, and the order. */
struct Envelope : OfReals {
    static constexpr const char *NAME = "Envelope";
    using Arguments = std::tuple<Indices, Indices, Indices, Array<double, 1>, Longs>;
    Indices first;
    LowerPlaces lower;
    Array<double, 1> signs;
    Longs order;
    Size n, size;

    static Size size_of(const Indices &first)
    {
        must(envelope_fits(span_of(first)),
             "columns of an envelope begin at their diagonal and end in order");
        return first.data[first.size - 1];
    }
    explicit Envelope(Arguments x)
        : first(std::move(std::get<0>(x))),
          lower(std::move(std::get<1>(x)), std::move(std::get<2>(x)), size_of(first)),
          signs(std::move(std::get<3>(x))), order(std::move(std::get<4>(x))), n(order.size),
          size(size_of(first))
    {
        must(first.size == n + 1 && signs.size == n && within(order, 0, n - 1),
             "there must be a sign for each row, and an order");
    }
};

Size py_envelope_size(Kept<Envelope> of) { return of->size; }

template <class T>
std::tuple<Array<T>, int> py_ldl_factor(Kept<Envelope> of, Terms<T> terms, Array<T> B)
{
    auto a = zeros<T>({of->size});
    of->lower.add(terms, B, a);
    auto least = room_for<double>(of->n);
    int info = ldl_factor<T>(of->n, of->first.data, of->signs.data, a.data, least.get());
    return {std::move(a), info};
}

template <class T, class R>
Array<R> py_ldl_solve(Kept<Envelope> of, Array<T, 1> factors, Array<R, 1> right)
{
    constexpr int parts = sizeof(R) / sizeof(T);
    must(factors.size == of->size && right.ends({of->n}),
         "factors and right sides must be those of the envelope");
    auto work = room_for<T>(8 * of->n);
    auto out = zeros_like<R>(right, 0, {});
    ldl_solve<T>(of->n, of->first.data, factors.data, of->order.data, right.rows(1) * parts, parts,
                 (const T *)right.data, work.get(), (T *)out.data);
    return out;
}

/* The fronts of a symmetric matrix from its entries left of the diagonal, row by row: (order, begin,
 * row_at, rows, factor_at, children, stack, most), and the multiplications of a factorisation. */
std::tuple<std::tuple<Numbered, Numbered, std::vector<int64_t>, Numbered, std::vector<int64_t>,
                      Numbered, Size, Size>,
           double>
py_eliminate(Longs first, Indices columns)
{
    must(lower_fits(span_of(first), span_of(columns)),
         "entries must stand left of the diagonal, row by row");
    FoundFronts x = fronts_found(first.size - 1, first.data, columns.data, columns.size);
    return {{x.order, x.begin, x.row_at, x.rows, x.factor_at, x.children, x.stack, x.most}, x.work};
}

struct FrontPlan : OfReals {
    static constexpr const char *NAME = "FrontPlan";
    using Arguments = std::tuple<Indices, Longs, Indices, Longs, Indices, Size, Size, Longs, Indices,
                                 Array<double, 1>, Longs, Indices, Indices>;
    Arguments of;
    Fronts fronts;
    std::optional<LowerPlaces> lower;

    explicit FrontPlan(Arguments arguments) : of(std::move(arguments))
    {
        auto &[begin, row_at, rows, factor_at, children, stack, most, column_at, column_rows, signs,
               order, chosen, places] = of;
        Size N = children.size, n = signs.size;
        fronts = {n,             N,          most,           stack,
                  begin.data,    row_at.data, rows.data,     factor_at.data,
                  children.data, column_at.data, column_rows.data, signs.data};
        must(begin.size == N + 1 && row_at.size == N + 1 && factor_at.size == N + 1 &&
                 column_at.size == n + 1 && order.size == n && within(order, 0, n - 1) &&
                 fronts_fit(&fronts, rows.size, column_rows.size),
             "these are no fronts of one matrix, or a front lacks rows");
        lower.emplace(std::move(chosen), std::move(places), column_at.data[n]);
    }
    const int64_t *order() const { return std::get<10>(of).data; }
};

/* (scaled values, scale, factors), and the pivot that fails. */
using Factored = std::tuple<Array<double>, Array<double>, Array<double>>;
std::tuple<Factored, Size> fronts_of(const FrontPlan &of, const Terms<double> &terms,
                                     const Array<double> &B, Size *excess)
{
    const Fronts &x = of.fronts;
    auto a = zeros<double>({(Size)x.column_at[x.n]}), scale = zeros<double>({x.n});
    auto factors = zeros<double>({(Size)x.factor_at[x.count]});
    auto room = room_for<double>(a.size + x.stack + 5 * x.most);
    auto at = room_for<int32_t>(2 * x.n);
    of.lower->add(terms, B, a);
    FrontRoom own = {
        a.data,  scale.data, room.get(), room.get() + a.size, room.get() + a.size + x.stack,
        at.get()};
    Size info = unlocked([&] { return fronts_factored(&x, &own, factors.data, excess); });
    return {Factored{std::move(a), std::move(scale), std::move(factors)}, info};
}

std::tuple<Factored, Size> py_fronts_factor(Kept<FrontPlan> of, Terms<double> terms,
                                            Array<double> B)
{
    return fronts_of(*of, terms, B, nullptr);
}

std::tuple<Size, double> py_fronts_signs(Kept<FrontPlan> of, Terms<double> terms, Array<double> B,
                                         bool counted)
{
    const Fronts &x = of->fronts;
    Size excess = 0;
    auto [factored, info] = fronts_of(*of, terms, B, counted ? &excess : nullptr);
    auto &[a, scale, factors] = factored;
    if (info)
        return {excess, INFINITY};
    auto sums = room_for<double>(x.n);
    return {excess, fronts_growth(&x, scale.data, factors.data, sums.get())};
}

template <class R>
std::tuple<Array<R>, double> py_fronts_solve(Kept<FrontPlan> of, Fields<3> factored,
                                             Array<R, 1> right, double enough)
{
    constexpr int parts = sizeof(R) / sizeof(double);
    const Fronts &x = of->fronts;
    const double *a, *scale, *factors;
    factored(a, {x.column_at[x.n]})(scale, {x.n})(factors, {x.factor_at[x.count]});
    must(right.ends({x.n}), "right sides must be those of the matrix");
    auto work = room_for<double>(12 * x.n + 4 * x.most);
    auto out = zeros_like<R>(right, 0, {});
    double worst = unlocked([&] {
        return fronts_solve(fmax(enough, TO_ROUND_OFF), &x, a, factors, of->order(), scale,
                            right.rows(1) * parts, parts, (const double *)right.data, work.get(),
                            (double *)out.data);
    });
    return {std::move(out), worst};
}
