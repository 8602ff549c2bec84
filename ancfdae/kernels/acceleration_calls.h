/* What Python calls of accelerations (index_1.h), and of explicit runs with them. */

/* ---- accelerations from lists --------------------------------------------------------------- */

/* Lists of a system with design and scale, and room for their work. */
struct ListAccelerations final : ListFormulas, OfReals {
    static constexpr const char *NAME = "ListAccelerations";
    using Arguments =
        std::tuple<std::vector<Kept<OperationList>>, Array<double, 1>, Array<double, 1>>;
    Arguments of;
    std::unique_ptr<double[]> memory;
    std::unique_ptr<int[]> rows_exchanged;

    explicit ListAccelerations(Arguments arguments) : of(std::move(arguments))
    {
        auto &[all, design, scales] = of;
        Index1System *s = &system;
        must(all.size() == INDEX_1_LISTS || all.size() == SIDES,
             "there must be six lists of operations, or three without derivatives");
        for (size_t i = 0; i < all.size(); i++)
            s->lists[i] = &all[i]->list, s->constants[i] = all[i]->constants<double>();
        s->b = design.data, s->n_b = design.size, s->scale = scales.data;
        n = s->n = std::max((s->lists[MATRIX]->n_inputs - 1 - s->n_b) / 2, (Size)0);
        m = s->m = scales.size - n, rows = s->rows = s->lists[SIDES] ? 1 + s->n_b : 1;
        Size size = n + m;
        must(index_1_fits(s), "lists, design and scale do not fit together");
        memory = room_for<double>(index_1_room() + index_1_lists_room(s));
        rows_exchanged = room_for<int>(size + 1);
        right = memory.get(), s->K = right + index_1_room();
        s->numbers = s->K + size * size, s->exchanged = rows_exchanged.get();
    }
};

/* ---- of scenes (scene_accelerations.h) ------------------------------------------------------- */

/* Laws that a function of Python evaluates: of times it returns the arrays of a `FactorTable`. Where
 * it raises, or something has been raised already, they are not known; `Bound` raises the error. */
struct CalledFactors final : SceneLaws {
    const Plan<double> *plan;
    Size n_b;
    Ref function;
    std::optional<Items> found;

    CalledFactors(const Plan<double> *of, Size variables, Ref called)
        : plan(of), n_b(variables), function(std::move(called))
    {
    }
    void take(Ref tables, Size k, FactorTable *to)
    {
        Size parts = plan->constraints->n_parts, orders = SceneFormulas::ORDERS_USED;
        Items &x = found.emplace(tables.get(), 4);
        x(to->joints, {orders, k, parts})(to->loads, {k, plan->n_factors});
        x.maybe(to->joints_b, {n_b, orders, k, parts}).maybe(to->loads_b, {n_b, k, plan->n_factors});
        to->k = k;
    }
    bool at(Size k, const double *t, FactorTable *to) override
    {
        Locked python;
        return guarded([&]() -> PyObject * {
            if (PyErr_Occurred())
                throw Failed();
            take(called(function, copied(k, t)), k, to);
            return Py_None;
        });
    }
};

/* A model with what its design variables change, None without any, and laws: a function of times, or
 * its result for all times. */
struct SceneAccelerations : OfReals {
    static constexpr const char *NAME = "SceneAccelerations";
    using Arguments = std::tuple<Kept<Model>, Ref, Ref>;
    Kept<Model> model;
    std::vector<Items> kept;
    std::optional<LawArguments<double>> of_elements;
    std::vector<Kept<LoadPlan>> moved;
    std::optional<CalledFactors> laws;
    std::optional<SceneFormulas> formulas;

    explicit SceneAccelerations(Arguments arguments) : model(std::move(std::get<0>(arguments)))
    {
        auto &[ignored, changed, factors] = arguments;
        const Plan<double> *p = &model->plan;
        must(!p->own, "accelerations must be those of a scene");
        SceneDesign design = {};
        if (changed.get() != Py_None)
            take_design(kept.emplace_back(changed.get(), 7), &design);
        Size n_b = design.n_b;
        formulas.emplace(p, &model->room, std::move(design));
        bool constant = PyTuple_Check(factors.get());
        laws.emplace(p, n_b, Ref(Py_NewRef(factors.get())));
        if (constant)
            laws->take(std::move(factors), 1, &formulas->table);
        else
            formulas->laws = &*laws;
    }

    /* (n_b, elements, mass, forces, loads, constraints, (load, variable, plan)...). */
    void take_design(Items &x, SceneDesign *to)
    {
        const Plan<double> *p = &model->plan;
        Size n = p->n_q, n_b = to->n_b = x.take<Size>();
        of_elements.emplace(x.take<LawArguments<double>>());
        to->elements = law_of_pairs<double>(**model->elements, p->damped, n_b, *of_elements);
        to->mass = csr_of<double>(x, n_b * n, n), x(to->forces, {n_b, n});
        to->loads = csr_of<double>(x, n_b * n, p->n_loads);
        to->constraints = constraint_partials(x.part(6), *p->constraints);
        must(to->constraints.n_b == n_b, "partials must be those of all design variables");
        for (Size i = 0; i < n_b * p->n_moving; i++) {
            auto &its = model->load_plans[(size_t)(i % p->n_moving)];
            to->moving.push_back({&its->table, its->template in<Complex>()});
        }
        for (auto &[load, i, plan] : x.take<std::vector<std::tuple<Size, Size, Kept<LoadPlan>>>>()) {
            must(load < p->n_moving && i < n_b && plan->table.n_q == n &&
                     plan->table.n_signals == p->moving[load].plan->n_signals,
                 "a moved load must be one of the loads");
            to->moving[(size_t)(i * p->n_moving + load)] = {&plan->table, plan->in<Complex>()};
            moved.push_back(std::move(plan));
        }
    }
};

/* ---- of both ------------------------------------------------------------------------------- */

/* Rows of (a, lam), or with `projected` states moved onto the constraints; else what prevents it. */
Ref accelerations_at(Index1 *of, bool projected, const Array<double, 1> &t,
                     const Array<double, 4> &states)
{
    Size count = 2 * of->rows * of->n, size = of->rows * (of->n + of->m);
    must(states.has({t.size, 2, of->rows, of->n}), "each state must have a time, and all rows");
    auto out = projected ? zeros_like<double>(states, 0, {})
                         : zeros_like<double>(states, 3, {of->rows, of->n + of->m});
    if (projected)
        std::copy(states.data, states.data + states.size, out.data);
    of->expect(t.size, t.data);
    for (Size k = 0; k < t.size; k++) {
        int trouble = projected
                          ? of->projected(t.data[k], out.data + k * count)
                          : of->solved(t.data[k], states.data + k * count, out.data + k * size);
        if (trouble)
            return Ref(given(trouble));
    }
    return Ref(out.release());
}

/* The equations of an object. */
Index1 *index_1_of(ListAccelerations &x) { return &x; }
Index1 *index_1_of(SceneAccelerations &x) { return &*x.formulas; }

template <class A>
Ref py_accelerations(Kept<A> of, bool projected, Array<double, 1> t, Array<double, 4> states)
{
    return accelerations_at(index_1_of(*of), projected, t, states);
}

template <class A> Size py_factorisations(Kept<A> of)
{
    return std::exchange(index_1_of(*of)->factorisations, 0);
}

/* ---- from Python ---------------------------------------------------------------------------- */

/* Accelerations and projected states from functions of Python, which return numbers or what
 * prevents them. */
struct CalledAccelerations final : Accelerations {
    Ref of_state, onto_constraints;

    CalledAccelerations(Ref first, Ref second, Size all_rows, Size coordinates, Size multipliers)
        : of_state(std::move(first)), onto_constraints(std::move(second))
    {
        rows = all_rows, n = coordinates, m = multipliers;
    }
    int at(const Ref &function, double t, const double *state, double *out, Size count)
    {
        auto rows_given = zeros<double>({2, rows, n});
        std::copy(state, state + rows_given.size, rows_given.data);
        Ref found = called(function, t, std::move(rows_given));
        if (PyLong_Check(found.get()))
            return (int)PyLong_AsLong(found.get());
        Array<double> values(found);
        must(values.size == count, "a function returns an array of another shape");
        std::copy(values.data, values.data + count, out);
        return all_finite(out, count) ? SOLVED : NOT_FINITE;
    }
    int solved(double t, const double *state, double *out) override
    {
        return at(of_state, t, state, out, rows * (n + m));
    }
    int projected(double t, double *state) override
    {
        return m ? at(onto_constraints, t, state, state, 2 * rows * n) : (int)SOLVED;
    }
};

/* ---- steps of DOP853 (explicit.h) ----------------------------------------------------------- */

/* A run from a state: its equations, tables of the method, and arrays that its steps write to. */
struct ExplicitRun : ExplicitSteps, OfReals {
    static constexpr const char *NAME = "ExplicitRun";
    using Arguments = std::tuple<Ref, Ref, Ref>;
    std::optional<Kept<ListAccelerations>> lists;
    std::optional<Kept<SceneAccelerations>> scene;
    std::optional<CalledAccelerations> functions;
    std::vector<Items> kept;
    std::unique_ptr<double[]> memory;

    explicit ExplicitRun(Arguments arguments) : ExplicitSteps()
    {
        auto &[equations, tables, state] = arguments;
        Size n, all_rows, m;
        double *to;
        kept.emplace_back(tables.get(), 4)(factors, {ALL_STAGES, 2, STEP_ROWS})(
            errors, {2, 2, STEP_STAGES})(nodes, {ALL_STAGES})(within, {STAGE_TERMS, ALL_STAGES});
        Items &own = kept.emplace_back(state.get(), 4);
        own(x, {STEP_ROWS, -1})(states, {ALL_STAGES, 2, &all_rows, &n})(
            out, {ALL_STAGES, all_rows, &m})(to, {(Size)(sizeof(StepControl) / sizeof(double))});
        control = (StepControl *)to, m -= n;
        if (PyTuple_Check(equations.get())) {
            Items pair(equations.get(), 2);
            Ref first = pair.take<Ref>();
            functions.emplace(std::move(first), pair.take<Ref>(), all_rows, n, m);
            of = &*functions;
        } else if (PyObject_TypeCheck(equations.get(), Object<SceneAccelerations>::type))
            of = index_1_of(*scene.emplace(equations.get()));
        else
            of = index_1_of(*lists.emplace(equations.get()));
        must(m >= 0 && of->rows == all_rows && of->n == n && of->m == m &&
                 Array<double, 2>(PyTuple_GetItem(state.get(), 0)).has({STEP_ROWS, all_rows * n}),
             "states of a run are not those of its equations");
        memory = room_for<double>(2 * all_rows * n * (1 + TERMS));
        scale = memory.get(), terms = scale + 2 * all_rows * n;
    }
};

std::tuple<int, Size, Array<double>> py_explicit(Kept<ExplicitRun> run, Fields<4> tolerances,
                                                 Array<double, 1> times, double stop, Size count,
                                                 Fields<4> kept)
{
    ExplicitRun &s = *run;
    Size rows = s.of->rows, n = s.of->n, room;
    KeptSteps to = {};
    s.rtol = tolerances.take<double>();
    tolerances(s.floor, {2, rows, n})(s.place, {n});
    s.vector = tolerances.take<Size>();
    must(s.vector > 0 && n % s.vector == 0, "tolerances do not fit");
    kept(to.spans, {&room, 2})(to.states, {room, &to.n_used, 2, rows, n})(
        to.lam, {room, to.n_used, rows, s.of->m})(to.used, {to.n_used});
    must(count <= room, "there is no room for the steps");
    for (Size i = 0; i < to.n_used; i++)
        must(to.used[i] >= 0 && to.used[i] < ALL_STAGES, "there is no such stage");
    must(times.size > 0, "there must be a time to reach");
    auto states = room_for<double>(times.size * 2 * rows * n);
    RecordedStates recorded = {times.data, times.size, 0, states.get()};
    Size taken = 0;
    int trouble = unlocked(
        [&] {
            return explicit_march(&s, times.data[times.size - 1], stop, count, &to, &recorded,
                                  &taken);
        },
        !s.functions);
    auto out = zeros<double>({recorded.done, 2, rows, n});
    std::copy(states.get(), states.get() + out.size, out.data);
    return {trouble, taken, std::move(out)};
}

Ref py_terms(Kept<ExplicitRun> s)
{
    int trouble = explicit_terms(&*s);
    if (trouble)
        return Ref(given(trouble));
    auto out = zeros<double>({TERMS, 2, s->of->rows, s->of->n});
    std::copy(s->terms, s->terms + out.size, out.data);
    return Ref(out.release());
}
