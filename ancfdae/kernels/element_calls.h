/* What Python calls of blocks of elements. */

/* (A, g_o, bending, tau, vectors, d, n_q): the law of all n elements, or one for all. */
template <class T> struct BlockArguments {
    std::tuple<Array<T, 3>, Array<T, 2>, Maybe<T, 2>, Maybe<T, 1>, Array<int64_t, 2>, Size, Size>
        of;
    Block<T> block;
    int n_y, d;

    explicit BlockArguments(PyObject *object) : of(From<decltype(of)>::object(object))
    {
        auto &[A, g_o, bending, tau, vectors, axes, n_q] = of;
        Size vectors_each = vectors.length(-1), n = vectors.rows(1), laws = A.rows(2);
        must(vectors_each >= 2 && vectors_each <= MOST_Y + 1 && axes >= 1 && axes <= 3,
             "an element has at most 8 relative node vectors of 3 numbers");
        n_y = (int)vectors_each - 1, d = (int)axes;
        Size n_g = packed_size();
        must(within(vectors, 0, n_q / d - 1), "a node vector is not among n_q numbers");
        must(A.ends({n_g, n_g}) && g_o.ends({n_g}) && g_o.rows(1) == laws &&
                 (laws == 1 || laws == n) &&
                 (!bending || (n_y >= 3 && bending->ends({2}) && bending->rows(1) == laws)) &&
                 (!tau || tau->size == n),
             "A, g_o and bending must be those of one element or of all, and tau of all");
        block = {n,      n_q,      laws == 1,        1,           vectors.data,
                 A.data, g_o.data, data_of(bending), data_of(tau)};
    }

    Size packed_size() const { return (Size)n_y * (n_y + 1) / 2; }

    /* The block at each row of coordinates, with velocities of the same shape, if any. */
    const Block<T> *at(const Array<T, 1> &q, const Maybe<T, 1> &v = {})
    {
        must(q.ends({block.n_q}) && (!v || v->alike(q)),
             "states must have n_q numbers, and velocities the shape of coordinates");
        block.k = q.rows(1);
        return &block;
    }

    /* Whether it takes long enough to let other threads run. */
    bool much() const { return block.k * block.n > 16; }
};

template <class T> Array<T> py_relative(BlockArguments<T> of, Array<T, 1> q)
{
    const Block<T> *b = of.at(q);
    auto out = zeros_like<T>(q, 1, {b->n, of.n_y, of.d});
    Unlocked others(of.much());
    relative<T>(of.n_y, of.d, b, q.data, out.data);
    return out;
}

template <class T> Array<T> py_lifted(BlockArguments<T> of, Array<T, 3> F)
{
    must(F.ends({of.block.n, of.n_y, of.d}), "forces must have the shape of relative node vectors");
    of.block.k = F.rows(3);
    auto out = zeros_like<T>(F, 3, {of.block.n_q});
    Unlocked others(of.much());
    lifted<T>(of.n_y, of.d, &of.block, F.data, out.data);
    return out;
}

template <class T> Array<T> py_forces(BlockArguments<T> of, Array<T, 1> q, Maybe<T, 1> v)
{
    const Block<T> *b = of.at(q, v);
    auto out = zeros_like<T>(q, 1, {b->n_q});
    Unlocked others(of.much());
    forces<T>(of.n_y, of.d, b, q.data, data_of(v), out.data);
    return out;
}

template <class T>
Array<T> py_forces_along(BlockArguments<T> of, Array<T, 1> q, Maybe<T, 1> v, Array<T, 1> u,
                         Maybe<T, 1> z)
{
    Size states = of.at(q, v)->k, k = of.at(u, z)->k;
    must((states == 1 || states == k) && (!v || z),
         "there must be one state for all directions or one for each");
    auto out = zeros_like<T>(u, 1, {of.block.n_q});
    Unlocked others(of.much());
    forces_along<T>(of.n_y, of.d, &of.block, states == 1, q.data, data_of(v), u.data, data_of(z),
                    out.data);
    return out;
}

template <class T>
Array<T> py_tangents(BlockArguments<T> of, Array<T, 1> q, Maybe<T, 1> v, bool damping,
                     Array<int32_t, 1> index, Size nnz)
{
    const Block<T> *b = of.at(q, v);
    Size size = (Size)(of.n_y + 1) * of.d;
    must(index.size == b->n * size * size && within(index, 0, nnz - 1),
         "index must hold a place among the values for each entry of each element");
    auto out = zeros_like<T>(q, 1, {nnz});
    Unlocked others(of.much());
    tangents<T>(of.n_y, of.d, b, q.data, data_of(v), damping, index.data, nnz, out.data);
    return out;
}

/* Partials A_b, rest_b and tau_b for the pairs of n elements and n_b variables. */
template <class T>
LawPartials<T> law_of_pairs(const BlockArguments<T> &of, bool moves, Size n_b,
                            const Array<T, 2> &A_b, const Array<T, 1> &rest_b,
                            const Array<T, 1> &tau_b, const Array<int64_t, 1> &first,
                            const Array<int64_t, 1> &pairs, const Array<int64_t, 1> &variables)
{
    Size n_g = of.packed_size(), n_stiff = A_b.rows(2);
    must(ascending(first.data, first.size, 1, pairs.size) && first.size == of.block.n + 1 &&
             A_b.ends({n_g, n_g}) && rest_b.ends({n_g + 2}) && rest_b.rows(1) == n_stiff &&
             (tau_b.size == 0 || moves) && pairs.size == variables.size &&
             within(pairs, 0, n_stiff + tau_b.size - 1) && within(variables, 0, n_b - 1),
         "partials must be those of pairs of elements and variables, one row each");
    return {n_stiff, first.data, pairs.data, variables.data, A_b.data, rest_b.data, tau_b.data};
}

template <class T>
Array<T> py_force_totals(BlockArguments<T> of, Array<T, 1> q, Maybe<T, 1> v, Array<T, 2> A_b,
                         Array<T, 1> rest_b, Array<T, 1> tau_b, Array<int64_t, 1> first,
                         Array<int64_t, 1> pairs, Array<int64_t, 1> variables)
{
    const Block<T> *b = of.at(q, v);
    auto law = law_of_pairs<T>(of, (bool)v, b->k - 1, A_b, rest_b, tau_b, first, pairs, variables);
    auto out = zeros_like<T>(q, 1, {b->n_q});
    if (b->k)
        force_totals<T>(of.n_y, of.d, b, &law, q.data, data_of(v), out.data);
    return out;
}

template <class T>
Array<T> py_force_partials(BlockArguments<T> of, Array<T, 1> q, Maybe<T, 1> v, Maybe<T, 1> mu,
                           Array<T, 2> A_b, Array<T, 1> rest_b, Array<T, 1> tau_b,
                           Array<int64_t, 1> first, Array<int64_t, 1> pairs,
                           Array<int64_t, 1> variables, Size n_b)
{
    const Block<T> *b = of.at(q, v);
    must(!mu || mu->alike(q), "covectors must have the shape of coordinates");
    auto law = law_of_pairs<T>(of, (bool)v, n_b, A_b, rest_b, tau_b, first, pairs, variables);
    auto out = mu ? zeros<T>({n_b}) : zeros<T>({b->k, n_b, b->n_q});
    Unlocked others;
    force_partials<T>(of.n_y, of.d, b, &law, n_b, q.data, data_of(v), data_of(mu), out.data);
    return out;
}

/* ---- packed matrices ------------------------------------------------------------------------ */

/* Strains where there is a g_o, else products, of node vectors Y, (..., n, n_y, d). */
template <class T>
Array<T> py_strain(Maybe<T, 1> g_o, Array<T, 2> Y, Maybe<T, 2> U, Maybe<T, 1> tau)
{
    Size n_y = Y.length(-2), d = Y.length(-1), n_g = n_y * (n_y + 1) / 2;
    Size n = Y.axes > 2 ? Y.length(-3) : 1, laws = g_o ? g_o->rows(1) : 1;
    must((g_o || (U && !tau)) && (!U || U->alike(Y)), "node vectors must have one shape");
    must(n_y >= 1 && n_y <= MOST_Y && d >= 1 && d <= 3,
         "an element has at most 8 relative node vectors of 3 numbers");
    must((!g_o || (g_o->ends({n_g}) && (laws == 1 || laws == n))) && (!tau || tau->size == n),
         "g_o must be that of one element or of all, and tau of all");
    Block<T> b = {n,       0,           0, n ? Y.rows(2) / n : 0, nullptr, nullptr, data_of(g_o),
                  nullptr, data_of(tau)};
    auto out = zeros_like<T>(Y, 2, {n_g});
    packed<T>((int)n_y, (int)d, &b, laws == 1, Y.data, data_of(U), out.data);
    return out;
}

template <class T> Array<T> py_stressed(Array<T, 1> p, Array<T, 2> Y)
{
    Size n_y = Y.length(-2), d = Y.length(-1), n = Y.rows(2);
    must(p.rows(1) == n && p.ends({n_y * (n_y + 1) / 2}),
         "there must be one p for each set of node vectors");
    must(n_y >= 1 && n_y <= MOST_Y && d >= 1 && d <= 3,
         "an element has at most 8 relative node vectors of 3 numbers");
    auto out = zeros_like<T>(Y, 0, {});
    stressed_each<T>((int)n_y, (int)d, n, p.data, Y.data, out.data);
    return out;
}
