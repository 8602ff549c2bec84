/* What Python calls of constraints and loads: plans, made once, and functions of them. */

/* Indices and numbers in the order of `ConstraintTable` and `ConstraintNumbers`. */
struct ConstraintPlan {
    static constexpr const char *NAME = "ancfdae.kernels._kernels.ConstraintPlan";
    static constexpr const char *MISSING = "constraints must be a plan of theirs";
    using Arguments = std::tuple<std::vector<Array<int32_t, 1>>,
                                 std::tuple<Numbers, Numbers, Numbers>, Size, Size, Size, Size,
                                 std::vector<Kept<OperationList>>>;
    Arguments of;
    std::vector<Formula> formulas;
    ConstraintTable plan = {};
    ConstraintNumbers<double> in_real;
    ConstraintNumbers<Complex> in_complex;
    bool complex_;

    explicit ConstraintPlan(Arguments arguments) : of(std::move(arguments))
    {
        auto &[x, numbers, d, n_q, n_values, n_curved, lists] = of;
        auto &[l, part_0, moving] = numbers;
        ConstraintTable *p = &plan;
        const int32_t **to[] = {&p->joints,       &p->first,         &p->columns, &p->linear_row,
                                &p->linear_at,    &p->row,           &p->i,       &p->j,
                                &p->place_linear, &p->place_product, &p->place_formula,
                                &p->formula,      &p->curved,        &p->moving_at,
                                &p->moving_part};
        must(x.size() == std::size(to), "a plan is made of 15 arrays of indices and 3 of numbers");
        for (size_t i = 0; i < x.size(); i++)
            *to[i] = x[i].data;
        complex_ = !l.in_real || !part_0.in_real || !moving.in_real;
        in_real = {data_of(l.in_real), data_of(part_0.in_real), data_of(moving.in_real)};
        in_complex = {l.in_complex.data, part_0.in_complex.data, moving.in_complex.data};
        p->n_joints = x[0].size / JOINT_ITEMS - 1;
        must(p->n_joints >= 0 && x[1].size > 0 && d >= 1 && d <= 3,
             "these are not the indices of constraints");
        p->d = (int)d, p->n_q = n_q, p->n_values = n_values, p->n_curved = n_curved;
        p->n_lam = p->joints[p->n_joints * JOINT_ITEMS + ROW];
        p->n_parts = p->joints[p->n_joints * JOINT_ITEMS + PART];
        p->n_a = x[3].size, p->n_s = x[5].size, p->n_z = p->joints[p->n_joints * JOINT_ITEMS + INPUT];
        p->n_c = p->n_a + p->n_s + p->n_lam + p->n_z;
        p->n_l = l.in_complex.size, p->n_moving = moving.in_complex.size;
        must(part_0.in_complex.size == p->n_c && x[14].size == p->n_moving &&
                 x[13].size == p->n_moving && within(x[13], 0, p->n_c - 1),
             "there must be a number for every entry of constraints");
        take_formulas(lists);
        must(fits(x), "these are not the indices of constraints");
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
            plan.room = std::max(plan.room, own.lists[which]->n_numbers);
        }
        plan.formulas = formulas.data(), plan.n_formulas = (Size)formulas.size();
    }

    /* Whether the lists of a joint with a formula take its numbers, and return as many as they must,
     * and there are places for them. */
    bool formula_fits(const int32_t *joint, const Formula *of) const
    {
        const int32_t *next = joint + JOINT_ITEMS;
        Size n_u = (next[VECTOR] - joint[VECTOR]) * plan.d, n_z = next[INPUT] - joint[INPUT];
        Size rows = next[ROW] - joint[ROW], all = n_u + n_z;
        Size of_l = entries(joint[VECTOR] * plan.d, (int)n_u);
        bool good = next[PLACE_FORMULA] - joint[PLACE_FORMULA] == rows * of_l;
        for (int which = 0; good && which < FORMULA_LISTS; which++) {
            int curved = which >= OF_CURVATURE, by_inputs = which >= OF_INPUTS && !curved;
            int order = curved ? which - OF_CURVATURE : which % ORDERS;
            Size size = curved ? n_u * n_u : by_inputs ? rows * n_z : which < ORDERS ? rows : rows * n_u;
            good = of->lists[which]->n_inputs == (order + 1) * all + curved * rows &&
                   of->lists[which]->n_outputs == size;
        }
        return good;
    }

    /* How many entries of L stand in the rows of a vector at a component. */
    Size entries(int32_t at, int components) const
    {
        return plan.first[at + components] - plan.first[at];
    }

    /* Whether everything of a joint lies within it, with as many places as are taken. */
    bool joint_fits(const int32_t *joint) const
    {
        const ConstraintTable *p = &plan;
        const int32_t *next = joint + JOINT_ITEMS;
        Size begin = joint[VECTOR] * p->d, end = next[VECTOR] * p->d, linear = 0, products = 0;
        bool good = true;
        for (int32_t e = joint[LINEAR]; good && e < next[LINEAR]; e++) {
            good = p->linear_at[e] >= begin && p->linear_at[e] < end;
            linear += good ? entries(p->linear_at[e], 1) : 0;
        }
        for (int32_t e = joint[PRODUCT]; good && e < next[PRODUCT]; e++) {
            good = p->i[e] >= begin && p->i[e] <= end - p->d && p->j[e] >= begin &&
                   p->j[e] <= end - p->d;
            products += good ? entries(p->i[e], p->d) + entries(p->j[e], p->d) : 0;
        }
        for (int32_t e = joint[MOVING]; good && e < next[MOVING]; e++)
            good = p->moving_part[e] >= joint[PART] && p->moving_part[e] < next[PART];
        const Formula *own = formula_of(p, joint);
        return good && linear == next[PLACE_LINEAR] - joint[PLACE_LINEAR] &&
               products == next[PLACE_PRODUCT] - joint[PLACE_PRODUCT] &&
               (own ? formula_fits(joint, own)
                    : next[INPUT] == joint[INPUT] && next[PLACE_FORMULA] == joint[PLACE_FORMULA]);
    }

    bool fits(const std::vector<Array<int32_t, 1>> &x)
    {
        ConstraintTable *p = &plan;
        Size n_U = x[1].size - 1, curved = 0;
        const Size ends[JOINT_ITEMS] = {n_U / p->d, p->n_a, p->n_s,    p->n_lam,   p->n_parts,
                                        p->n_moving, p->n_z, x[8].size, x[9].size, x[10].size};
        bool good = n_U % p->d == 0 && p->n_parts > 0 && x[2].size == p->n_l &&
                    x[0].size == (p->n_joints + 1) * JOINT_ITEMS;
        for (int i = 0; good && i < JOINT_ITEMS; i++)
            good = i == PART ? p->joints[PART] == 1 &&
                                   p->joints[p->n_joints * JOINT_ITEMS + PART] == p->n_parts
                             : ascending(p->joints + i, p->n_joints + 1, JOINT_ITEMS, ends[i]);
        for (Size k = 0; good && k < p->n_joints; k++)
            good = p->joints[(k + 1) * JOINT_ITEMS + PART] >= p->joints[k * JOINT_ITEMS + PART];
        good = good && ascending(p->first, n_U + 1, 1, p->n_l) && within(x[2], 0, p->n_q - 1) &&
               x[4].size == p->n_a && x[6].size == p->n_s && x[7].size == p->n_s &&
               within(x[3], 0, p->n_lam - 1) && within(x[5], 0, p->n_lam - 1) &&
               within(x[8], 0, p->n_values - 1) && within(x[9], 0, p->n_values - 1) &&
               within(x[10], 0, p->n_values - 1) && x[11].size == p->n_joints &&
               within(x[11], -1, p->n_formulas - 1);
        for (Size k = 0; good && k < p->n_joints; k++) {
            const int32_t *joint = p->joints + k * JOINT_ITEMS;
            p->most = std::max(p->most, (Size)(joint[JOINT_ITEMS + VECTOR] - joint[VECTOR]) * p->d);
            good = joint_fits(joint);
        }
        for (Size e = 0; good && e < p->n_s; e++)
            for (int axis = 0; axis < p->d; axis++)
                curved += 2 * entries(p->i[e] + axis, 1) * entries(p->j[e] + axis, 1);
        p->curved_formula = p->curved + std::min(curved, x[12].size);
        for (Size k = 0; good && k < p->n_joints; k++) {
            const int32_t *joint = p->joints + k * JOINT_ITEMS;
            Size n_u = (joint[JOINT_ITEMS + VECTOR] - joint[VECTOR]) * p->d;
            Size of_l = entries(joint[VECTOR] * p->d, (int)n_u);
            curved += p->formula[k] < 0 ? 0 : of_l * of_l;
        }
        return good && curved == x[12].size && within(x[12], 0, p->n_curved - 1);
    }

    template <class T> const auto &in() const { return held_in<T>(in_real, in_complex); }
};

/* Rows of states with factors of time, (orders, k or 1, n_parts), and lam, if any. */
template <class T> struct ConstraintStates {
    const ConstraintTable *p;
    const ConstraintNumbers<T> *numbers;
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
        : p(&plan.plan), numbers(&plan.in<T>()), factors(factors), multipliers(lam), motion(motion),
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
        coefficients<T>(p, numbers, n, instants > 1 ? instant : 0, instants, factors.data,
                        work.get(), c);
        for (int order = 0; order <= n; order++)
            X[order] = motion[(size_t)order].data + instant * p->n_q;
        lam = multipliers ? multipliers->data + instant * p->n_lam : nullptr;
    }
};

template <class T>
Array<T> py_constraints(Kept<ConstraintPlan> plan, Size what, Array<T, 3> factors, Maybe<T, 1> lam,
                        Rest<Array<T, 1>> motion)
{
    ConstraintStates<T> x(*plan, factors, lam, motion);
    must(what <= FORCE, "a number is negative or too large");
    must((what == FORCE) == (bool)lam, "multipliers belong to forces");
    const Size sizes[] = {x.p->n_lam, x.p->n_values, x.p->n_q}, size = sizes[what];
    auto out = zeros_like<T>(motion[0], 1, {size});
    for (Size k = 0; k < x.k; k++) {
        x.at(k);
        constraints<T>(x.p, x.numbers->l, (int)what, x.n, x.c, x.X, x.lam, x.U,
                       out.data + k * size);
    }
    return out;
}

template <class T>
Array<T> py_constraint_curvature(Kept<ConstraintPlan> plan, Array<T, 3> factors, Array<T, 1> w,
                                 Rest<Array<T, 1>> motion)
{
    Maybe<T, 1> lam(std::move(w));
    ConstraintStates<T> x(*plan, factors, lam, motion);
    must(!x.p->n_formulas || x.n < FORMULA_ORDERS, "formulas have first rates of curvatures only");
    auto out = zeros_like<T>(motion[0], 1, {x.p->n_curved});
    for (Size k = 0; k < x.k; k++) {
        x.at(k);
        constraint_curvature<T>(x.p, x.numbers->l, x.n, x.c, x.X, x.lam, x.U,
                                out.data + k * x.p->n_curved);
    }
    return out;
}

template <class T>
std::tuple<Array<T>, Array<T>> py_constraint_gradient(Kept<ConstraintPlan> plan,
                                                      Array<T, 3> factors, Array<T, 1> w,
                                                      Rest<Array<T, 1>> motion)
{
    Maybe<T, 1> lam(std::move(w));
    ConstraintStates<T> x(*plan, factors, lam, motion);
    must(!x.p->n_formulas || x.n < FORMULA_ORDERS, "formulas have gradients of first rates only");
    Size n_l = x.p->n_l, rows = (x.n + 1) * x.p->n_c;
    auto on_l = zeros_like<T>(motion[0], 1, {n_l});
    auto on_c = zeros_like<T>(motion[0], 1, {x.n + 1, x.p->n_c});
    for (Size k = 0; k < x.k; k++) {
        x.at(k);
        constraint_gradient<T>(x.p, x.numbers->l, x.n, x.c, x.X, x.lam, x.U, on_l.data + k * n_l,
                               on_c.data + k * rows);
    }
    return {std::move(on_l), std::move(on_c)};
}

Array<double>
py_constraint_totals(Kept<ConstraintPlan> plan,
                     std::tuple<Array<int32_t, 1>, Array<int32_t, 1>, Array<int32_t, 1>,
                                Array<int32_t, 1>, Array<int32_t, 1>, Array<double, 1>>
                         entries,
                     Array<double, 3> factors, Maybe<double, 4> factors_b, Maybe<double, 1> lam,
                     Maybe<double, 2> lam_b, std::vector<Array<double, 1>> motion,
                     std::optional<std::vector<Array<double, 2>>> motion_b)
{
    ConstraintStates<double> x(*plan, factors, lam, motion);
    const ConstraintTable *p = x.p;
    auto &[variable, number, first, part, entry, value] = entries;
    Size n_b = variable.size - 1, k = x.k;
    must(!plan->complex_, "totals are those of real numbers");
    must(ascending(variable.data, n_b + 1, 1, number.size) && first.size == number.size + 1 &&
             ascending(first.data, first.size, 1, value.size) &&
             within(number, 0, p->n_joints - 1) && part.size == value.size &&
             within(part, 0, p->n_parts - 1) && entry.size == value.size &&
             within(entry, 0, p->n_l + p->n_c - 1),
         "these are not the partials of constraints");
    must(x.instants == k, "there must be factors for each state");
    must(!factors_b || factors_b->ends({n_b, x.n + 1, k, p->n_parts}),
         "factors_b must be (n_b, ...)");
    auto rows = [&](const Array<double, 2> &of, Size size) {
        must(of.ends({n_b, size}) && of.rows(2) == k,
             "there must be a row of derivatives for each instant and variable");
        return of.data;
    };
    must(motion_b ? motion_b->size() == motion.size() : !lam_b,
         "there must be derivatives of all of the motion, or of none and not of lam");
    TotalStates states = {lam ? FORCE : RATE,
                          x.n,
                          k,
                          factors.data,
                          {},
                          {},
                          data_of(lam),
                          lam_b ? rows(*lam_b, p->n_lam) : nullptr};
    for (size_t i = 0; i < motion.size(); i++) {
        states.X[i] = motion[i].data;
        states.X_b[i] = motion_b ? rows((*motion_b)[i], p->n_q) : nullptr;
    }
    ConstraintPartials partials = {n_b,       variable.data, number.data, first.data,
                                   part.data, entry.data,    value.data,  data_of(factors_b)};
    auto work = room_for<Complex>(totals_work(p, x.n));
    auto out = zeros<double>({k, n_b, lam ? p->n_q : p->n_lam});
    constraint_totals(p, x.numbers, &partials, &states, work.get(), out.data);
    return out;
}

/* ---- loads ---------------------------------------------------------------------------------- */

/* Whether operations read numbers that stand before them only. */
bool in_order(Size ahead, const Array<int32_t, 1> &op, const Array<int32_t, 1> &a,
              const Array<int32_t, 1> &b)
{
    bool good = within(op, 0, OPERATIONS - 1) && a.size == op.size && b.size == op.size;
    for (Size k = 0; good && k < op.size; k++)
        good = a.data[k] >= 0 && a.data[k] < ahead + k && b.data[k] >= 0 && b.data[k] < ahead + k;
    return good;
}

/* Indices in the order of `LoadTable`, and numbers: entries of L, constants, and own numbers of
 * copies. */
struct LoadPlan {
    static constexpr const char *NAME = "ancfdae.kernels._kernels.LoadPlan";
    static constexpr const char *MISSING = "the first argument must be the plan of a load";
    using Indices = Array<int32_t, 1>;
    using Arguments =
        std::tuple<std::tuple<Indices, Indices, Indices, Indices, Indices, Indices, Indices, Indices>,
                   std::tuple<Numbers, Numbers, Numbers>, Size, Size, Size, Size>;
    Arguments of;
    LoadTable plan;
    LoadNumbers<double> in_real;
    LoadNumbers<Complex> in_complex;
    bool complex_;

    explicit LoadPlan(Arguments arguments) : of(std::move(arguments))
    {
        auto &[indices, numbers, n_q, n_values, n_signals, n_copies] = of;
        auto &[first, columns, op, a, b, output, places, gates] = indices;
        auto &[l, constants, own] = numbers;
        must(n_copies > 0, "a load must have a copy");
        Size n_l = l.in_complex.size, n_U = (first.size - 1) / n_copies;
        Size n_c = constants.in_complex.size, n_own = own.in_complex.size / n_copies;
        Size ahead = 2 * n_U + n_signals + n_own + n_c, entries = 0;
        complex_ = !l.in_real || !constants.in_real || !own.in_real;
        in_real = {data_of(l.in_real), data_of(constants.in_real), data_of(own.in_real)};
        in_complex = {l.in_complex.data, constants.in_complex.data, own.in_complex.data};
        plan = {n_q,         n_U,        n_signals,    n_own,   n_c,    op.size, ahead + op.size,
                n_values,    n_copies,   gates.size,   first.data, columns.data, op.data, a.data,
                b.data,      output.data, places.data, gates.data};
        must(n_signals >= 0 && first.size == n_copies * n_U + 1 &&
                 own.in_complex.size == n_copies * n_own &&
                 ascending(first.data, first.size, 1, n_l) && columns.size == n_l &&
                 within(columns, 0, n_q - 1) && in_order(ahead, op, a, b) && output.size == n_U &&
                 within(output, 0, plan.n_numbers - 1) && within(places, 0, n_values - 1) &&
                 within(gates, 0, op.size - 1),
             "these are not the indices of a load");
        for (Size copy = 0; copy < n_copies; copy++) {
            Size of_copy = first.data[(copy + 1) * n_U] - first.data[copy * n_U];
            entries += of_copy * of_copy;
        }
        must(places.size == entries, "there must be a place for each entry of a tangent");
    }

    template <class T> const auto *in() const { return &held_in<T>(in_real, in_complex); }
};

/* Run f(factors, offset of q and v, work, row of out) at each time; `lanes` as in `load_work`. */
template <class T, class F>
Array<T> loaded(const LoadPlan &plan, std::initializer_list<const Array<T, 2> *> factors,
                std::initializer_list<const Array<T, 2> *> states, Size lanes, Size size, F f)
{
    const Array<T, 2> &q = **states.begin();
    Size k = q.rows(1), n_q = plan.plan.n_q, n = 1 + plan.plan.n_signals;
    for (const Array<T, 2> *x : states)
        must(x->ends({n_q}) && x->alike(q), "states must have n_q numbers, and one shape");
    for (const Array<T, 2> *x : factors)
        must(x->ends({n}) && x->rows(1) == k, "there must be factors for each instant");
    auto work = room_for<T>(load_work<T>(&plan.plan, lanes));
    auto out = zeros_like<T>(q, 1, {size});
    for (Size i = 0; i < k; i++)
        f(i * n, i * n_q, work.get(), out.data + i * size);
    return out;
}

template <class T>
Array<T> py_load_forces(Kept<LoadPlan> of, Array<T, 2> factors, Array<T, 2> q, Array<T, 2> v)
{
    const LoadTable *p = &of->plan;
    return loaded<T>(*of, {&factors}, {&q, &v}, 0, p->n_q, [&](Size i, Size at, T *work, T *to) {
        load_force<T>(p, of->in<T>(), factors.data + i, q.data + at, v.data + at, work, to);
    });
}

template <class T>
Array<T> py_load_forces_along(Kept<LoadPlan> of, Array<T, 2> factors, Array<T, 2> rates,
                              Array<T, 2> q, Array<T, 2> v, Array<T, 2> dq, Array<T, 2> dv)
{
    const LoadTable *p = &of->plan;
    return loaded<T>(*of, {&factors, &rates}, {&q, &v, &dq, &dv}, 1, p->n_q,
                     [&](Size i, Size at, T *work, T *to) {
                         load_force_along<T>(p, of->in<T>(), factors.data + i, rates.data + i,
                                             q.data + at, v.data + at, dq.data + at, dv.data + at,
                                             work, to);
                     });
}

template <class T>
Array<T> py_load_tangents(Kept<LoadPlan> of, Array<T, 2> factors, Array<T, 2> q, Array<T, 2> v,
                          bool velocity)
{
    const LoadTable *p = &of->plan;
    return loaded<T>(*of, {&factors}, {&q, &v}, p->n_U, p->n_values,
                     [&](Size i, Size at, T *work, T *to) {
                         load_tangent<T>(p, of->in<T>(), 1, factors.data + i, q.data + at,
                                         v.data + at, velocity, work, to);
                     });
}
