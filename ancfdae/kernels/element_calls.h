/* What Python calls of blocks of elements. */

/* The law of all n elements, or one for all, and their node vectors, among n_q numbers. */
struct Elements {
    static constexpr const char *NAME = "Block";
    using Arguments = std::tuple<Numbers, Numbers, std::optional<Numbers>, std::optional<Numbers>,
                                 Array<int64_t, 2>, Size, Size>;
    Arguments of;
    Size n, n_q, n_g, laws;
    int n_y, d;
    bool in_complex;

    explicit Elements(Arguments arguments) : of(std::move(arguments))
    {
        auto &[A, g_o, bending, tau, vectors, axes, size] = of;
        Size vectors_each = vectors.length(-1);
        n = vectors.rows(1), n_q = size;
        must(vectors_each >= 2 && vectors_each <= MOST_Y + 1 && axes >= 1 && axes <= 3,
             "an element has at most 8 relative node vectors of 3 numbers");
        n_y = (int)vectors_each - 1, d = (int)axes, n_g = (Size)n_y * (n_y + 1) / 2;
        must(within(vectors, 0, n_q / d - 1), "a node vector is not among n_q numbers");
        laws = A.axes > 2 ? A.rows(2) : 1;
        must(A.axes > 2 && g_o.axes > 1 && A.ends({n_g, n_g}) && g_o.ends({n_g}) &&
                 g_o.rows(1) == laws && (laws == 1 || laws == n) &&
                 (!bending || (n_y >= 3 && bending->ends({2}) && bending->axes > 1 &&
                               bending->rows(1) == laws)) &&
                 (!tau || tau->size == n),
             "A, g_o and bending must be those of one element or of all, and tau of all");
        in_complex = A.in_complex || g_o.in_complex || (bending && bending->in_complex) ||
                     (tau && tau->in_complex);
    }

    /* The block at k states. */
    template <class T> Block<T> in(Size k) const
    {
        auto &[A, g_o, bending, tau, vectors, axes, size] = of;
        return {n, n_q, laws == 1, k, vectors.data, A.in<T>(), g_o.in<T>(),
                bending ? bending->in<T>() : nullptr, tau ? tau->in<T>() : nullptr};
    }

    /* The same at each row of coordinates, with velocities of the same shape, if any. */
    template <class T> Block<T> at(const Array<T, 1> &q, const Maybe<T, 1> &v = {}) const
    {
        must(q.ends({n_q}) && (!v || v->alike(q)),
             "states must have n_q numbers, and velocities the shape of coordinates");
        return in<T>(q.rows(1));
    }
};

/* Whether a block takes long enough to let other threads run. */
template <class T> bool much(const Block<T> &b) { return b.k * b.n > 16; }

template <class T> Array<T> py_relative(Kept<Elements> of, Array<T, 1> q)
{
    auto b = of->at(q);
    auto out = zeros_like<T>(q, 1, {b.n, of->n_y, of->d});
    unlocked([&] { relative<T>(of->n_y, of->d, &b, q.data, out.data); }, much(b));
    return out;
}

template <class T> Array<T> py_lifted(Kept<Elements> of, Array<T, 3> F)
{
    must(F.ends({of->n, of->n_y, of->d}), "forces must have the shape of relative node vectors");
    auto b = of->in<T>(F.rows(3));
    auto out = zeros_like<T>(F, 3, {b.n_q});
    unlocked([&] { lifted<T>(of->n_y, of->d, &b, F.data, out.data); }, much(b));
    return out;
}

template <class T> Array<T> py_forces(Kept<Elements> of, Array<T, 1> q, Maybe<T, 1> v)
{
    auto b = of->at(q, v);
    auto out = zeros_like<T>(q, 1, {b.n_q});
    unlocked([&] { forces<T>(of->n_y, of->d, &b, q.data, data_of(v), out.data); }, much(b));
    return out;
}

template <class T>
Array<T> py_forces_along(Kept<Elements> of, Array<T, 1> q, Maybe<T, 1> v, Array<T, 1> u,
                         Maybe<T, 1> z)
{
    Size states = of->at(q, v).k;
    auto b = of->at(u, z);
    must((states == 1 || states == b.k) && (!v || z),
         "there must be one state for all directions or one for each");
    auto out = zeros_like<T>(u, 1, {b.n_q});
    auto along = [&] {
        forces_along<T>(of->n_y, of->d, &b, states == 1, q.data, data_of(v), u.data, data_of(z),
                        out.data);
    };
    unlocked(along, much(b));
    return out;
}

template <class T>
Array<T> py_tangents(Kept<Elements> of, Array<T, 1> q, Maybe<T, 1> v, bool damping, Indices index,
                     Size nnz)
{
    auto b = of->at(q, v);
    Size size = (Size)(of->n_y + 1) * of->d;
    must(index.size == b.n * size * size && within(index, 0, nnz - 1),
         "index must hold a place among the values for each entry of each element");
    auto out = zeros_like<T>(q, 1, {nnz});
    auto all = [&] {
        tangents<T>(of->n_y, of->d, &b, q.data, data_of(v), damping, index.data, nnz, out.data);
    };
    unlocked(all, much(b));
    return out;
}

/* (A_b, rest_b, tau_b, first, pairs, variables): partials for pairs of elements and variables. */
template <class T>
using LawArguments = std::tuple<Array<T, 2>, Array<T, 1>, Array<T, 1>, Longs, Longs, Longs>;

template <class T>
LawPartials<T> law_of_pairs(const Elements &of, bool moves, Size n_b, const LawArguments<T> &law)
{
    auto &[A_b, rest_b, tau_b, first, pairs, variables] = law;
    Size n_stiff = A_b.rows(2);
    must(ascending(first, pairs.size) && first.size == of.n + 1 && A_b.ends({of.n_g, of.n_g}) &&
             rest_b.ends({of.n_g + 2}) && rest_b.rows(1) == n_stiff && (tau_b.size == 0 || moves) &&
             pairs.size == variables.size && within(pairs, 0, n_stiff + tau_b.size - 1) &&
             within(variables, 0, n_b - 1),
         "partials must be those of pairs of elements and variables, one row each");
    return {n_stiff, first.data, pairs.data, variables.data, A_b.data, rest_b.data, tau_b.data};
}

template <class T>
Array<T> py_force_totals(Kept<Elements> of, Array<T, 1> q, Maybe<T, 1> v, LawArguments<T> law_b)
{
    auto b = of->at(q, v);
    auto law = law_of_pairs<T>(*of, (bool)v, b.k - 1, law_b);
    auto out = zeros_like<T>(q, 1, {b.n_q});
    if (b.k)
        force_totals<T>(of->n_y, of->d, &b, &law, q.data, data_of(v), out.data);
    return out;
}

template <class T>
Array<T> py_force_partials(Kept<Elements> of, Array<T, 1> q, Maybe<T, 1> v, Maybe<T, 1> mu,
                           LawArguments<T> law_b, Size n_b)
{
    auto b = of->at(q, v);
    must(!mu || mu->alike(q), "covectors must have the shape of coordinates");
    auto law = law_of_pairs<T>(*of, (bool)v, n_b, law_b);
    auto out = mu ? zeros<T>({n_b}) : zeros<T>({b.k, n_b, b.n_q});
    unlocked([&] {
        force_partials<T>(of->n_y, of->d, &b, &law, n_b, q.data, data_of(v), data_of(mu), out.data);
    });
    return out;
}

/* ---- packed matrices ------------------------------------------------------------------------ */

/* n_y and d of node vectors. */
std::pair<int, int> sizes_of(const Shaped &Y)
{
    Size n_y = Y.length(-2), d = Y.length(-1);
    must(n_y >= 1 && n_y <= MOST_Y && d >= 1 && d <= 3,
         "an element has at most 8 relative node vectors of 3 numbers");
    return {(int)n_y, (int)d};
}

template <class T>
Array<T> py_strain(Maybe<T, 1> g_o, Array<T, 2> Y, Maybe<T, 2> U, Maybe<T, 1> tau)
{
    auto [n_y, d] = sizes_of(Y);
    Size n_g = n_y * (n_y + 1) / 2, n = Y.axes > 2 ? Y.length(-3) : 1, laws = g_o ? g_o->rows(1) : 1;
    must((g_o || (U && !tau)) && (!U || U->alike(Y)), "node vectors must have one shape");
    must((!g_o || (g_o->ends({n_g}) && (laws == 1 || laws == n))) && (!tau || tau->size == n),
         "g_o must be that of one element or of all, and tau of all");
    Block<T> b = {n,       0,           0, n ? Y.rows(2) / n : 0, nullptr, nullptr, data_of(g_o),
                  nullptr, data_of(tau)};
    auto out = zeros_like<T>(Y, 2, {n_g});
    packed<T>(n_y, d, &b, laws == 1, Y.data, data_of(U), out.data);
    return out;
}

template <class T> Array<T> py_stressed(Array<T, 1> p, Array<T, 2> Y)
{
    auto [n_y, d] = sizes_of(Y);
    must(p.rows(1) == Y.rows(2) && p.ends({n_y * (n_y + 1) / 2}),
         "there must be one p for each set of node vectors");
    auto out = zeros_like<T>(Y, 0, {});
    stressed_each<T>(n_y, d, Y.rows(2), p.data, Y.data, out.data);
    return out;
}
