/* What Python calls of constraints and loads: plans, made once, and functions of them. */

/* Indices and numbers in the order of `ConstraintTable` and `ConstraintNumbers`. */
struct ConstraintPlan {
    static constexpr const char *NAME = "ConstraintPlan";
    using Arguments =
        std::tuple<std::vector<Indices>, std::tuple<Numbers, Numbers, Numbers>, Size, Size, Size,
                   Size, std::vector<Kept<OperationList>>>;
    Arguments of;
    std::vector<Formula> formulas;
    ConstraintTable table = {};
    bool in_complex;

    explicit ConstraintPlan(Arguments arguments) : of(std::move(arguments))
    {
        auto &[x, numbers, d, n_q, n_values, n_curved, lists] = of;
        auto &[l, part_0, moving] = numbers;
        ConstraintTable *p = &table;
        const int32_t **to[] = {&p->joints,       &p->first,         &p->columns, &p->linear_row,
                                &p->linear_at,    &p->row,           &p->i,       &p->j,
                                &p->place_linear, &p->place_product, &p->place_formula,
                                &p->formula,      &p->curved,        &p->moving_at,
                                &p->moving_part};
        Span<int32_t> spans[std::size(to)];
        must(x.size() == std::size(to), "a plan is made of 15 arrays of indices and 3 of numbers");
        for (size_t i = 0; i < x.size(); i++)
            *to[i] = x[i].data, spans[i] = span_of(x[i]);
        in_complex = l.in_complex || part_0.in_complex || moving.in_complex;
        p->n_joints = x[0].size / JOINT_ITEMS - 1;
        must(p->n_joints >= 0 && x[1].size > 0 && d >= 1 && d <= 3,
             "these are not the indices of constraints");
        const int32_t *end = p->joints + p->n_joints * JOINT_ITEMS;
        p->d = (int)d, p->n_q = n_q, p->n_values = n_values, p->n_curved = n_curved;
        p->n_lam = end[ROW], p->n_parts = end[PART], p->n_z = end[INPUT];
        p->n_a = x[3].size, p->n_s = x[5].size, p->n_l = l.size, p->n_moving = moving.size;
        p->n_c = p->n_a + p->n_s + p->n_lam + p->n_z;
        must(part_0.size == p->n_c, "there must be a number for every entry of constraints");
        take_formulas(lists);
        must(ConstraintCheck{p, spans}.fits(), "these are not the indices of constraints");
    }

    void take_formulas(const std::vector<Kept<OperationList>> &lists)
    {
        must(lists.size() % FORMULA_LISTS == 0, "a formula must have twelve lists of operations");
        formulas.resize(lists.size() / FORMULA_LISTS);
        for (size_t i = 0; i < lists.size(); i++) {
            Formula &own = formulas[i / FORMULA_LISTS];
            size_t which = i % FORMULA_LISTS;
            own.lists[which] = &lists[i]->list;
            own.in_real[which] = lists[i]->constants<double>();
            own.in_complex[which] = lists[i]->constants<Complex>();
            table.room = std::max(table.room, own.lists[which]->n_numbers);
        }
        table.formulas = formulas.data(), table.n_formulas = (Size)formulas.size();
    }

    template <class T> ConstraintNumbers<T> in() const
    {
        auto &[l, part_0, moving] = std::get<1>(of);
        return {l.in<T>(), part_0.in<T>(), moving.in<T>()};
    }
};

/* Rows of states with factors of time, (orders, k or 1, n_parts), and lam, if any. */
template <class T> struct ConstraintStates {
    const ConstraintTable *p;
    ConstraintNumbers<T> numbers;
    const Array<T, 3> &factors;
    const Maybe<T, 1> &multipliers;
    const std::vector<Array<T, 1>> &motion;
    int n;
    Size k, instants;
    std::unique_ptr<T[]> work;
    const T *c[ORDERS], *X[ORDERS], *lam;
    T *U;

    ConstraintStates(const ConstraintPlan &plan, const Array<T, 3> &factors, const Maybe<T, 1> &lam,
                     const std::vector<Array<T, 1>> &motion)
        : p(&plan.table), numbers(plan.in<T>()), factors(factors), multipliers(lam), motion(motion),
          n((int)motion.size() - 1)
    {
        must(n >= 0 && n < ORDERS, "there must be coordinates and up to three time derivatives");
        for (const auto &x : motion)
            must(x.ends({p->n_q}) && x.alike(motion[0]),
                 "states must have n_q numbers, and one shape");
        k = motion[0].rows(1), instants = factors.length(1);
        must(factors.has({-1, -1, p->n_parts}) && factors.length(0) > n &&
                 (instants == 1 || instants == k),
             "factors must be (orders, instants, n_parts)");
        must(!lam || (lam->ends({p->n_lam}) && lam->rows(1) == k),
             "there must be n_lam multipliers for each state");
        work = room_for<T>((n + 1) * p->n_c + vectors_room(p, n));
        U = work.get() + (n + 1) * p->n_c;
    }

    /* Coefficients and states of an instant. */
    void at(Size instant)
    {
        coefficients<T>(p, &numbers, n, instants > 1 ? instant : 0, instants, factors.data,
                        work.get(), c);
        for (int order = 0; order <= n; order++)
            X[order] = motion[(size_t)order].data + instant * p->n_q;
        lam = multipliers ? multipliers->data + instant * p->n_lam : nullptr;
    }
};

template <class T>
Array<T> py_evaluate(Kept<ConstraintPlan> plan, Size what, Array<T, 3> factors, Maybe<T, 1> lam,
                        Rest<Array<T, 1>> motion)
{
    ConstraintStates<T> x(*plan, factors, lam, motion);
    must(what <= FORCE, "a number is negative or too large");
    must((what == FORCE) == (bool)lam, "multipliers belong to forces");
    const Size sizes[] = {x.p->n_lam, x.p->n_values, x.p->n_q}, size = sizes[what];
    auto out = zeros_like<T>(motion[0], 1, {size});
    for (Size k = 0; k < x.k; k++) {
        x.at(k);
        constraints<T>(x.p, x.numbers.l, (int)what, x.n, x.c, x.X, x.lam, x.U,
                       out.data + k * size);
    }
    return out;
}

template <class T>
Array<T> py_curvature(Kept<ConstraintPlan> plan, Array<T, 3> factors, Array<T, 1> w,
                      Rest<Array<T, 1>> motion)
{
    Maybe<T, 1> lam(std::move(w));
    ConstraintStates<T> x(*plan, factors, lam, motion);
    must(!x.p->n_formulas || x.n < FORMULA_ORDERS, "formulas have first rates of curvatures only");
    auto out = zeros_like<T>(motion[0], 1, {x.p->n_curved});
    for (Size k = 0; k < x.k; k++) {
        x.at(k);
        constraint_curvature<T>(x.p, x.numbers.l, x.n, x.c, x.X, x.lam, x.U,
                                out.data + k * x.p->n_curved);
    }
    return out;
}

template <class T>
std::tuple<Array<T>, Array<T>> py_gradient(Kept<ConstraintPlan> plan, Array<T, 3> factors,
                                           Array<T, 1> w, Rest<Array<T, 1>> motion)
{
    Maybe<T, 1> lam(std::move(w));
    ConstraintStates<T> x(*plan, factors, lam, motion);
    must(!x.p->n_formulas || x.n < FORMULA_ORDERS, "formulas have gradients of first rates only");
    Size n_l = x.p->n_l, rows = (x.n + 1) * x.p->n_c;
    auto on_l = zeros_like<T>(motion[0], 1, {n_l});
    auto on_c = zeros_like<T>(motion[0], 1, {x.n + 1, x.p->n_c});
    for (Size k = 0; k < x.k; k++) {
        x.at(k);
        constraint_gradient<T>(x.p, x.numbers.l, x.n, x.c, x.X, x.lam, x.U, on_l.data + k * n_l,
                               on_c.data + k * rows);
    }
    return {std::move(on_l), std::move(on_c)};
}

/* (variable, number, first, part, entry, value): what design variables change in constraints. */
ConstraintPartials constraint_partials(Items &entries, const ConstraintTable &p)
{
    ConstraintPartials of = {};
    Size n, numbers, values;
    entries(of.variable, {&n})(of.number, {&numbers})(of.first, {numbers + 1})(of.part, {&values})(
        of.entry, {values})(of.value, {values});
    of.n_b = n - 1;
    must(ascending(Span<int32_t>{of.variable, n}, numbers) &&
             ascending(Span<int32_t>{of.first, numbers + 1}, values) &&
             within(Span<int32_t>{of.number, numbers}, 0, p.n_joints - 1) &&
             within(Span<int32_t>{of.part, values}, 0, p.n_parts - 1) &&
             within(Span<int32_t>{of.entry, values}, 0, p.n_l + p.n_c - 1),
         "these are not the partials of constraints");
    return of;
}

Array<double> py_totals(Kept<ConstraintPlan> plan, Fields<6> entries, Array<double, 3> factors,
                        Maybe<double, 4> factors_b, Maybe<double, 1> lam, Maybe<double, 2> lam_b,
                        std::vector<Array<double, 1>> motion,
                        std::optional<std::vector<Array<double, 2>>> motion_b)
{
    ConstraintStates<double> x(*plan, factors, lam, motion);
    const ConstraintTable *p = x.p;
    ConstraintPartials of = constraint_partials(entries, *p);
    Size n_b = of.n_b, k = x.k;
    of.orders = x.n + 1;
    must(x.instants == k && (!factors_b || factors_b->ends({n_b, x.n + 1, k, p->n_parts})),
         "there must be factors for each state, and factors_b for each variable");
    of.factors_b = data_of(factors_b);
    auto rows = [&](const Array<double, 2> &array, Size size) {
        must(array.ends({n_b, size}) && array.rows(2) == k,
             "there must be a row of derivatives for each instant and variable");
        return array.data;
    };
    must(motion_b ? motion_b->size() == motion.size() : !lam_b,
         "there must be derivatives of all of the motion, or of none and not of lam");
    TotalStates states = {lam ? FORCE : RATE, x.n, k, factors.data, {}, {}, data_of(lam),
                          lam_b ? rows(*lam_b, p->n_lam) : nullptr};
    for (size_t i = 0; i < motion.size(); i++) {
        states.X[i] = motion[i].data;
        states.X_b[i] = motion_b ? rows((*motion_b)[i], p->n_q) : nullptr;
    }
    auto work = room_for<Complex>(totals_work(p, x.n));
    auto out = zeros<double>({k, n_b, lam ? p->n_q : p->n_lam});
    constraint_totals(p, &x.numbers, &of, &states, work.get(), out.data);
    return out;
}

/* ---- loads ---------------------------------------------------------------------------------- */

/* Indices in the order of `LoadTable`, and numbers: entries of L, constants, and own numbers of
 * copies. */
struct LoadPlan {
    static constexpr const char *NAME = "LoadPlan";
    using Arguments = std::tuple<std::vector<Indices>, std::tuple<Numbers, Numbers, Numbers>, Size,
                                 Size, Size, Size>;
    Arguments of;
    LoadTable table;
    bool in_complex;

    explicit LoadPlan(Arguments arguments) : of(std::move(arguments))
    {
        auto &[x, numbers, n_q, n_values, n_signals, n_copies] = of;
        auto &[l, constants, own] = numbers;
        must(n_copies > 0 && x.size() == 8, "a load must have a copy, and eight arrays of indices");
        Size n_U = (x[0].size - 1) / n_copies, n_own = own.size / n_copies, n_op = x[2].size;
        Size ahead = 2 * n_U + n_signals + n_own + constants.size;
        in_complex = l.in_complex || constants.in_complex || own.in_complex;
        table = {n_q,       n_U,       n_signals, n_own,     constants.size, n_op,
                 ahead + n_op, n_values, n_copies, x[7].size, x[0].data,     x[1].data,
                 x[2].data, x[3].data, x[4].data, x[5].data, x[6].data,      x[7].data};
        must(own.size == n_copies * n_own && x[3].size == n_op && x[4].size == n_op &&
                 load_fits(&table, l.size, span_of(x[0]), span_of(x[1]), span_of(x[5]),
                           span_of(x[6]), span_of(x[7])),
             "these are not the indices of a load, with a place for each entry of its tangent");
    }

    template <class T> LoadNumbers<T> in() const
    {
        auto &[l, constants, own] = std::get<1>(of);
        return {l.in<T>(), constants.in<T>(), own.in<T>()};
    }
};

/* Run f(plan, numbers, offset of factors, of q and v, work, row of out) at each time; `lanes` as in
 * `load_work`. */
template <class T, class F>
Array<T> loaded(const LoadPlan &plan, std::initializer_list<const Array<T, 2> *> factors,
                std::initializer_list<const Array<T, 2> *> states, Size lanes, Size size, F f)
{
    const LoadTable *p = &plan.table;
    const Array<T, 2> &q = **states.begin();
    Size k = q.rows(1), n_q = p->n_q, n = 1 + p->n_signals;
    for (const Array<T, 2> *x : states)
        must(x->ends({n_q}) && x->alike(q), "states must have n_q numbers, and one shape");
    for (const Array<T, 2> *x : factors)
        must(x->ends({n}) && x->rows(1) == k, "there must be factors for each instant");
    auto work = room_for<T>(load_work<T>(p, lanes));
    auto out = zeros_like<T>(q, 1, {size});
    LoadNumbers<T> numbers = plan.in<T>();
    for (Size i = 0; i < k; i++)
        f(p, &numbers, i * n, i * n_q, work.get(), out.data + i * size);
    return out;
}

template <class T>
Array<T> py_load(Kept<LoadPlan> of, Array<T, 2> factors, Array<T, 2> q, Array<T, 2> v)
{
    return loaded<T>(*of, {&factors}, {&q, &v}, 0, of->table.n_q,
                     [&](auto p, auto numbers, Size i, Size at, T *work, T *to) {
                         load_force<T>(p, numbers, factors.data + i, q.data + at, v.data + at, work,
                                       to);
                     });
}

template <class T>
Array<T> py_load_along(Kept<LoadPlan> of, Array<T, 2> factors, Array<T, 2> rates, Array<T, 2> q,
                       Array<T, 2> v, Array<T, 2> dq, Array<T, 2> dv)
{
    return loaded<T>(*of, {&factors, &rates}, {&q, &v, &dq, &dv}, 1, of->table.n_q,
                     [&](auto p, auto numbers, Size i, Size at, T *work, T *to) {
                         load_force_along<T>(p, numbers, factors.data + i, rates.data + i,
                                             q.data + at, v.data + at, dq.data + at, dv.data + at,
                                             work, to);
                     });
}

template <class T>
Array<T> py_load_tangents(Kept<LoadPlan> of, Array<T, 2> factors, Array<T, 2> q, Array<T, 2> v,
                          bool velocity)
{
    return loaded<T>(*of, {&factors}, {&q, &v}, of->table.n_U, of->table.n_values,
                     [&](auto p, auto numbers, Size i, Size at, T *work, T *to) {
                         load_tangent<T>(p, numbers, 1, factors.data + i, q.data + at, v.data + at,
                                         velocity, work, to);
                     });
}
