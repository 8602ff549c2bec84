/* A system for marches, stages, passes and equilibria: its arrays, checked once, and its room.
 *
 * `equations/plans.py` says what a plan holds.
 */

/* Equations that functions of Python evaluate: mass, Phi_q, Phi or its rate, Q, (f_q, f_v or None),
 * and loads that turn with their derivative. Where T is double the real parts of what they return
 * count. */
template <class T> struct Called final : Equations<T> {
    enum { MASS, JACOBIAN, CONSTRAINT, FORCE, TANGENTS, FOLLOWING, FUNCTIONS };
    std::vector<Ref> of;
    Size n_q, n_lam, n_B, nnz;

    static void taken(Ref found, Size n, T *to)
    {
        if (std::is_same<T, double>::value && is_complex(found.get()))
            found = made(PyObject_GetAttrString(found.get(), "real"));
        Array<T> x(found);
        must(x.size == n, "a function of a system returns an array of another size");
        std::copy(x.data, x.data + n, to);
    }
    /* Of two parts of n and nnz numbers; the second one is taken if there is a place for it. */
    void both(Ref found, Size n, T *to, T *second)
    {
        auto [one, other] = From<std::tuple<Ref, Ref>>::object(found.get());
        taken(std::move(one), n, to);
        if (second && other.get() != Py_None)
            taken(std::move(other), nnz, second);
    }
    Array<T> row(const T *x) const { return copied(n_q, x); }

    void mass(const T *q, T *M) override
    {
        Locked python;
        taken(called(of[MASS], row(q)), nnz, M);
    }
    void jacobian(T t, const T *q, T *B) override
    {
        Locked python;
        taken(called(of[JACOBIAN], real_part(t), row(q)), n_B, B);
    }
    void constraint(T t, int order, const T *q, const T *v, T *Phi) override
    {
        Locked python;
        const Ref &f = of[CONSTRAINT];
        double at = real_part(t);
        taken(order == 0   ? called(f, at, row(q))
              : order == 1 ? called(f, at, row(q), row(v))
                           : called(f, at, row(q), row(v), zeros<T>({n_q})),
              n_lam, Phi);
    }
    void force(T t, const T *q, const T *v, T *Q) override
    {
        Locked python;
        taken(called(of[FORCE], real_part(t), row(q), row(v)), n_q, Q);
    }
    void tangents(T t, const T *q, const T *v, const T *A, const T *lam, T *f_q, T *f_v) override
    {
        Locked python;
        both(called(of[TANGENTS], real_part(t), row(q), row(v), row(A), copied(n_lam, lam)), nnz,
             f_q, f_v);
    }
    bool following(T t, const T *q, T *P, T *P_q) override
    {
        Locked python;
        both(called(of[FOLLOWING], real_part(t), row(q)), n_q, P, P_q);
        return true;
    }
};

/* A function of Python that factorises: of terms, each a number and values, and of B, it makes a
 * function of a right side and whether the matrix is transposed, or None. */
struct CalledSolver final : MatrixSolver {
    Ref function, factors;
    Size n, nnz, n_B;

    CalledSolver(Ref of, Size unknowns, Size values, Size values_of_B)
        : function(std::move(of)), n(unknowns), nnz(values), n_B(values_of_B)
    {
    }
    bool fails(int terms, const double *numbers, const double *const *values,
               const double *B) override
    {
        Locked python;
        Ref sum = made(PyTuple_New(terms));
        for (int i = 0; i < terms; i++) {
            Ref term(given(std::tuple<double, Array<double>>{numbers[i], copied(nnz, values[i])}));
            PyTuple_SetItem(sum.get(), i, term.release());
        }
        factors = called(function, std::move(sum), copied(n_B, B));
        return factors.get() == Py_None;
    }
    void solve(bool transposed, Size rows, const double *right, double *x) override
    {
        Locked python;
        for (Size i = 0; i < rows; i++) {
            Array<double> found(called(factors, copied(n, right + i * n), transposed));
            must(found.size == n, "a function that solves returns an array of another size");
            std::copy(found.data, found.data + n, x + i * n);
        }
    }
};

/* A matrix (first, columns, values); any number of rows if n < 0. */
template <class T> Csr<T> csr_of(Items &x, Size n, Size n_columns)
{
    Csr<T> m;
    Size size, nnz;
    x.part(3)(m.first, {&size})(m.columns, {&nnz})(m.values, {nnz});
    must(csr_fits({m.first, size}, {m.columns, nnz}, nnz, n_columns) && (n < 0 || size == n + 1),
         "a matrix of a plan has another size");
    m.n = size - 1;
    return m;
}

/* A plan of a system with its room. */
template <class T> struct Planned {
    enum { SCENE_ITEMS = 14, LIST_ITEMS = 8, CALLED_ITEMS = 6 };
    Items given;
    std::vector<MovingLoad<T>> moving;
    std::optional<Kept<Elements>> elements; /* of a scene */
    std::vector<Kept<LoadPlan>> load_plans;
    Listed<T> listed = {};
    Called<T> callers = {};
    ConstraintTable sizes = {}; /* of a system of one's own */
    Plan<T> plan = {};
    Room<T> room = {};
    std::vector<T> memory;

    Planned(const Ref &x, const Array<double> &rules) : given(x.get(), -1)
    {
        must(rules.size == sizeof(MarchRules) / sizeof(double), "there are other rules of marches");
        memcpy(&plan.rules, rules.data, sizeof plan.rules);
        must(given.size() == SCENE_ITEMS || given.size() == LIST_ITEMS ||
                 given.size() == CALLED_ITEMS,
             "a system must be a plan of a scene, of lists or of functions");
        if (given.size() == SCENE_ITEMS)
            take_scene();
        else if (given.size() == LIST_ITEMS)
            take_lists();
        else
            take_functions();
    }

    /* (block, places, M, mass on the pattern, gravity, loads, weights, inverse, constraints, B, two
     * functions, loads that move, each with whether it uses velocities, and which of them turn). */
    void take_scene()
    {
        Plan<T> *p = &plan;
        const Kept<Elements> &block = elements.emplace(given.take<Kept<Elements>>());
        Size n = p->n_q = block->n_q, size = (Size)(block->n_y + 1) * block->d;
        p->block = block->in<T>(1), p->n_y = block->n_y, p->d = block->d;
        p->damped = p->velocity = p->block.tau != nullptr;
        given(p->index, {block->n, size * size});
        p->M = csr_of<T>(given, n, n), p->K = csr_of<T>(given, n, n), p->nnz = p->K.first[n];
        must(within(Span<int32_t>{p->index, block->n * size * size}, 0, p->nnz - 1),
             "an index of a plan is too large");
        given(p->gravity, {n})(p->loads, {&p->n_loads, n})(p->weights, {n})(p->inverse, {n});
        auto constraints = given.take<Kept<ConstraintPlan>>();
        const ConstraintTable &c = constraints->table;
        must(c.n_q == n && c.n_curved == p->nnz, "constraints must be those of the coordinates");
        p->constraints = &c, p->numbers = constraints->template in<T>();
        p->n_lam = c.n_lam, p->still = c.n_parts == 1;
        take_pattern(&p->B, p->n_lam);
        must(p->B.first[p->n_lam] == c.n_values,
             "there must be a value for each entry of the constraint Jacobian");
        given.take<Ignored>(), given.take<Ignored>();
        p->n_factors = p->n_loads;
        for (auto &[load, velocity] : given.take<std::vector<std::tuple<Kept<LoadPlan>, bool>>>()) {
            must(load->table.n_q == n && load->table.n_values == p->nnz,
                 "loads must be those of the coordinates");
            moving.push_back({&load->table, load->template in<T>(), velocity, p->n_factors});
            p->n_factors += 1 + load->table.n_signals;
            p->velocity |= velocity;
            load_plans.push_back(std::move(load));
        }
        p->moving = moving.data(), p->n_moving = (Size)moving.size();
    }

    /* A matrix of which the pattern counts. */
    void take_pattern(Csr<T> *to, Size rows)
    {
        Csr<double> pattern = csr_of<double>(given, rows, plan.n_q);
        *to = {pattern.n, pattern.first, pattern.columns, nullptr};
    }

    /* Weights, their inverses, B, K and whether forces use velocities: of a system of one's own,
     * whose factors are the times. */
    void take_sizes()
    {
        Plan<T> *p = &plan;
        given(p->weights, {&p->n_q})(p->inverse, {p->n_q});
        take_pattern(&p->B, -1), take_pattern(&p->K, p->n_q);
        p->velocity = given.take<bool>();
        p->n_lam = p->B.n, p->nnz = p->K.first[p->n_q];
        sizes.n_q = p->n_q, sizes.n_lam = p->n_lam, sizes.n_values = p->B.first[p->n_lam];
        p->constraints = &sizes, p->n_factors = sizes.n_parts = 1;
    }

    /* (lists, b, then sizes), and a time that has been added to all that come. */
    void take_lists()
    {
        auto own = given.take<std::vector<Kept<OperationList>>>();
        given(listed.b, {&listed.n_b});
        take_sizes();
        Size n = listed.n_q = plan.n_q, n_lam = listed.n_lam = plan.n_lam, nnz = plan.nnz;
        Size outputs[] = {sizes.n_values, n_lam, n_lam, n_lam, n, nnz, (plan.velocity ? 2 : 1) * nnz};
        must(own.size() == MARCH_LISTS, "a plan must have seven lists of operations");
        for (size_t i = 0; i < MARCH_LISTS; i++) {
            const Operations *of = listed.of[i] = &own[i]->list;
            listed.constants[i] = own[i]->template constants<T>();
            must(of->n_inputs == 1 + 3 * n + n_lam + listed.n_b && of->n_outputs == outputs[i],
                 "lists must be those of the coordinates");
        }
        plan.own = &listed;
    }

    /* (functions, then sizes). */
    void take_functions()
    {
        callers.of = given.take<std::vector<Ref>>();
        must(callers.of.size() == Called<T>::FUNCTIONS, "a plan must have six functions");
        take_sizes();
        callers.n_q = plan.n_q, callers.n_lam = plan.n_lam, callers.nnz = plan.nnz;
        callers.n_B = sizes.n_values;
        plan.own = &callers;
    }

    /* Give room to what an iteration writes, and to pointers beside; return what is left of it. */
    T *give_room(std::vector<Wanted<T>> all, Size left)
    {
        rooms_of(plan, listed.of[0] ? listed.room() : 0, &room, &listed.numbers, &all);
        T *at = room_given(all, left, &memory);
        if (plan.own)
            plan.K.values = room.mass, plan.M = plan.K;
        return at;
    }
};

/* A system at real numbers, with its matrices. */
struct Model : Planned<double>, OfReals {
    static constexpr const char *NAME = "Model";
    using Arguments = std::tuple<Ref, Fields<5>, Array<double>, Ref>;
    Items layout;
    std::optional<CalledSolver> solver;

    explicit Model(Arguments arguments)
        : Planned<double>(std::get<0>(arguments), std::get<2>(arguments)),
          layout(std::move(std::get<1>(arguments)))
    {
        Ref &function = std::get<3>(arguments);
        if (function.get() != Py_None)
            plan.solver = &solver.emplace(std::move(function), plan.n_q + plan.n_lam, plan.nnz,
                                          plan.constraints->n_values);
        take_layout();
        Size n = plan.n_q + plan.n_lam;
        double *left = give_room(matrix_rooms(plan, &room), n + (plan.fronts ? n : 0));
        room.pivots = (int *)left, room.in_fronts.at = (int32_t *)(left + n);
        if (plan.flat)
            plan.gbtrf = gbtrf_of<double>(), plan.gbtrs = gbtrs_of<double>();
    }

    void take_lower(const LowerPlaces &lower)
    {
        must(lower.least <= plan.nnz && lower.of_B() == plan.constraints->n_values,
             "an index of a plan is too large");
        plan.chosen = lower.chosen.data, plan.n_chosen = lower.chosen.size;
        plan.places = lower.places.data;
    }

    /* (order, scale, envelope, band, fronts). */
    void take_layout()
    {
        Plan<double> *p = &plan;
        Size n = p->n_q + p->n_lam;
        layout(p->order, {n})(p->scale, {n});
        auto envelope = layout.take<std::optional<Kept<Envelope>>>();
        auto band = layout.take<std::optional<Kept<Band>>>();
        auto fronts = layout.take<std::optional<Kept<FrontPlan>>>();
        must((envelope || band || fronts || solver) && within(Span<int64_t>{p->order, n}, 0, n - 1),
             "a layout must have an order, and an envelope, a band or fronts");
        must((!fronts || (*fronts)->fronts.n == n) && (!envelope || (*envelope)->n == n) &&
                 (!band || ((*band)->n == n &&
                            (*band)->flat().size == p->nnz + 2 * p->constraints->n_values)),
             "the envelope, band or fronts are not those of the matrix");
        if (fronts)
            p->fronts = &(*fronts)->fronts, take_lower(*(*fronts)->lower);
        if (envelope) {
            p->first = (*envelope)->first.data, p->signs = (*envelope)->signs.data;
            take_lower((*envelope)->lower);
        }
        if (band)
            p->half = (*band)->half, p->flat = (*band)->flat().data,
            p->factors = (*band)->factors();
    }
};

/* A system at complex numbers, with a model of their real parts. */
struct ComplexModel : Planned<Complex>, OfReals { /* `Either` is not asked. */
    static constexpr const char *NAME = "ComplexModel";
    using Arguments = std::tuple<Ref, Kept<Model>, Array<double>>;
    Kept<Model> model;

    explicit ComplexModel(Arguments arguments)
        : Planned<Complex>(std::get<0>(arguments), std::get<2>(arguments)),
          model(std::move(std::get<1>(arguments)))
    {
        const Plan<double> &real = model->plan;
        must(real.n_q == plan.n_q && real.n_lam == plan.n_lam && real.nnz == plan.nnz &&
                 real.n_factors == plan.n_factors &&
                 real.constraints->n_values == plan.constraints->n_values &&
                 real.constraints->n_c == plan.constraints->n_c,
             "the model of the real parts is that of another system");
        plan.real = &real, plan.real_room = &model->room;
        give_room({}, 0);
    }
};

using Counts = std::tuple<Size, Size, Size>;

template <class T, class M>
std::tuple<Size, int, double, Array<T>, Counts, double, double>
py_march(Kept<M> model, Fields<5> state, double motion, Array<double> h, Array<T, 3> of_joints,
         Array<T, 3> of_loads, double seconds, Fields<4> rows, Ref guess, Fields<3> limits)
{
    const Plan<T> *p = &model->plan;
    Room<T> *r = &model->room;
    Size k = h.size, n_q = p->n_q, n_lam = p->n_lam;
    Before<T> b = {};
    Attempt<T> how = {};
    T *to[4];
    state(b.q, {n_q})(b.v, {n_q})(b.a, {n_q})(b.lam, {n_lam})(b.A, {n_q});
    rows(to[0], {k, n_q})(to[1], {k, n_q})(to[2], {k, n_q})(to[3], {k, n_lam});
    std::optional<Items> own_guess;
    if (guess.get() != Py_None)
        own_guess.emplace(guess.get(), 2)(how.a, {n_q})(how.lam, {n_lam});
    how.tolerance = limits.take<double>(), how.allowed = limits.take<double>();
    how.iterations = (double)limits.take<Size>();
    must(h.has({k}) && of_loads.has({k, 2, p->n_factors}) &&
             of_joints.has({p->still ? -1 : k, -1, p->constraints->n_parts}),
         "there must be factors for each step");
    Size instants = p->still ? +ALL_INSTANTS : of_joints.length(1);
    must(instants >= 2, "a table must tell the factors at both ends of a step");
    auto last = zeros<T>({n_q});
    b.motion = motion;
    Ending ending = {motion, INFINITY, 0};
    int ends = ALL_TAKEN;
    memset(r->counts, 0, sizeof r->counts);
    Size steps = unlocked([&] {
        return marched<T>(p, r, &b, k, h.data, instants, of_joints.data, of_loads.data,
                          seconds_now() + seconds, &how, to, last.data, &ends, &ending);
    });
    return {steps, ends, b.motion, std::move(last),
            Counts{r->counts[0], r->counts[1], r->counts[2]}, ending.size, ending.slowest};
}

/* ---- steps under error control (control.h) -------------------------------------------------- */

StepFilter *filter_of(const InPlace<double> &numbers)
{
    must(numbers.has({sizeof(StepFilter) / sizeof(double)}), "there are other numbers of a filter");
    return (StepFilter *)numbers.data;
}

std::tuple<int, double, double> py_plan_step(InPlace<double> filter, Array<double, 1> stops, double t)
{
    double h = 0, end = t;
    int planned = step_planned(filter_of(filter), stops.size, stops.data, t, &h, &end);
    return {planned, h, end};
}

Size py_judge_step(InPlace<double> filter, Size n, double t, double h, std::optional<double> error)
{
    return step_judged(filter_of(filter), n, t, h, error.has_value(), error.value_or(NAN));
}

/* Laws that a function of Python evaluates: of (t, end, h) it returns rows of factors of joints, at
 * least some, and of loads, and (turn / 1 rad)^order. */
template <class T> struct CalledLaws final : StepLaws<T> {
    const Plan<T> *plan;
    Ref function;
    Size least, of_loads;
    std::optional<Items> found;

    CalledLaws(const Plan<T> *of, std::tuple<Ref, double> &given, std::vector<double> fractions,
               Size rows, Size rows_of_loads)
        : StepLaws<T>(std::get<1>(given), fractions), plan(of), function(std::move(std::get<0>(given))),
          least(rows), of_loads(rows_of_loads)
    {
        must(function.get() != Py_None || of->own || (of->still && of->n_factors == 0),
             "there must be laws of a system with factors");
    }
    bool at(double t, double end, double h, StepTables<T> *to) override
    {
        if (function.get() == Py_None)
            return StepLaws<T>::at(t, end, h, to);
        Locked python;
        return guarded([&]() -> PyObject * {
            Items &tables = found.emplace(called(function, t, end, h).get(), 3);
            tables(to->of_joints, {&to->instants, plan->constraints->n_parts})(
                to->of_loads, {of_loads, plan->n_factors});
            to->turn = tables.template take<double>();
            must(plan->still || to->instants >= least, "there must be factors at all instants");
            if (plan->still)
                to->instants = (Size)this->fractions.size();
            return Py_None;
        });
    }
};

/* Take the control of a run from (numbers of a filter, stops), the first one empty for known steps, with
 * (n, t, size of the step before) and rows (ends, numbers of filters). */
void take_control(StepRun *c, Items &control, Items &beside,
                  const std::tuple<Size, double, double> &at)
{
    Size k, numbers = sizeof(StepFilter) / sizeof(double);
    double *filters;
    beside(c->ends, {&k})(filters, {k, numbers});
    auto filter = control.take<InPlace<double>>();
    control(c->stops, {&c->n_stops});
    c->filter = filter.size ? filter_of(filter) : nullptr;
    c->filters = (StepFilter *)filters, c->most = k;
    std::tie(c->n, c->t, c->last) = at;
}

/* A function of Python that returns the error of derivatives of a step, of (h, end). */
std::function<bool(double, double, double *)> errors_of(const Ref &function)
{
    if (function.get() == Py_None)
        return nullptr;
    return [&function](double h, double end, double *error) -> bool {
        Locked python;
        return guarded([&]() -> PyObject * {
            *error = From<double>::object(called(function, h, end).get());
            return Py_None;
        });
    };
}

template <class T, class M>
std::tuple<Size, int, Size, Counts, double>
py_march_controlled(Kept<M> model, Fields<5> state, std::tuple<Size, double, double> at,
                    double motion, Fields<2> control, Fields<4> tolerance, std::tuple<Ref, double> laws, Ref along,
                    Fields<4> rows, Fields<2> of_steps, Fields<2> beside,
                    std::tuple<double, Size, double> limits)
{
    const Plan<T> *p = &model->plan;
    Room<T> *r = &model->room;
    Size n_q = p->n_q;
    ControlledRun<T> c{};
    take_control(&c, control, of_steps, at);
    Size k = c.most;
    must(c.filter, "there are other numbers of a filter");
    beside(c.a, {k, n_q})(c.motion, {k});
    state(c.first.q, {n_q})(c.first.v, {n_q})(c.first.a, {n_q})(c.first.lam, {p->n_lam})(
        c.first.A, {n_q});
    rows(c.rows[0], {k, n_q})(c.rows[1], {k, n_q})(c.rows[2], {k, n_q})(c.rows[3], {k, p->n_lam});
    c.tolerance.rtol = tolerance.take<double>(), c.tolerance.n = n_q;
    tolerance(c.tolerance.least, {n_q})(c.place, {n_q});
    c.tolerance.d = tolerance.take<Size>();
    must(c.tolerance.d > 0 && n_q % c.tolerance.d == 0, "vectors do not fit");
    const double *g = p->rules.places;
    CalledLaws<T> of_laws(p, laws, {1, 0, g[0], g[1], g[2], g[0], g[1], g[2]}, 2, 2);
    auto [newton, iterations, seconds] = limits;
    Attempt<T> how = {nullptr, nullptr, newton, INFINITY, (double)iterations};
    c.plan = p, c.room = r, c.laws = &of_laws, c.how = &how, c.along = errors_of(along);
    c.until = seconds_now() + seconds, c.first.motion = motion, c.ending = {motion, INFINITY, 0};
    memset(r->counts, 0, sizeof r->counts);
    int why = unlocked([&] { return steps_taken(&c); });
    return {c.taken, why, c.rejected, Counts{r->counts[0], r->counts[1], r->counts[2]},
            c.ending.size};
}

/* ---- passes --------------------------------------------------------------------------------- */

/* (h, q, v, lam, of_joints, of_loads, matrices) of k steps; (M, f_q, f_v or None, Phi_q) there, for
 * a system of one's own; and (which are small, G, g), if any is, for n_b variables. */
ComputedSteps steps_of(Items &x, const Plan<double> &p, Size n_b)
{
    ComputedSteps s = {};
    Size n_B = p.constraints->n_values;
    x(s.h, {&s.k});
    Size k = s.k;
    x(s.q, {k, p.n_q})(s.v, {k, p.n_q})(s.lam, {k, p.n_lam})(
        s.of_joints, {p.still ? -1 : k, p.constraints->n_parts})(s.of_loads, {k, p.n_factors})(
        s.matrices, {k, 6, 4});
    Items *local = x.maybe_part(4), *small = x.maybe_part(3);
    must((local != nullptr) == (p.own != nullptr), "steps must be linearised for lists alone");
    if (local) {
        (*local)(s.M, {&s.rows_of_M, p.nnz})(s.f_q, {k, p.nnz});
        local->maybe(s.f_v, {k, p.nnz})(s.Phi_q, {k, n_B});
        must((s.rows_of_M == 1 || s.rows_of_M == k) && (s.f_v != nullptr) == (p.velocity != 0),
             "M and f_v must be those of the plan");
    }
    if (small)
        (*small)(s.small, {k})(s.G, {k, n_B})(s.g, {k, p.n_lam, n_b});
    return s;
}

std::tuple<Size, int> py_differentiate_steps(Kept<Model> model, Fields<9> steps,
                                             InPlace<double> right, InPlace<double> z,
                                             InPlace<double> states, InPlace<double> lam_b,
                                             Size first)
{
    const Plan<double> *p = &model->plan;
    must(z.has({4, -1, p->n_q}), "states must have the shapes of a plan");
    Size n = p->n_q + p->n_lam, n_b = z.length(1);
    ComputedSteps s = steps_of(steps, *p, n_b);
    must(right.has({s.k, n_b, n}) && states.has({s.k + 1, 3, n_b, p->n_q}) &&
             lam_b.has({s.k, n_b, p->n_lam}) && first <= s.k,
         "states must have the shapes of a plan");
    auto work = room_for<double>(n_b * n);
    int ends = ALL_TAKEN;
    Size taken = unlocked([&] {
        return differentiated(p, &model->room, &s, first, n_b, right.data, z.data, states.data,
                              lam_b.data, work.get(), &ends);
    });
    return {taken, ends};
}

std::tuple<Size, int> py_pull_back_steps(Kept<Model> model, Fields<9> steps, Fields<3> seeds,
                                         Fields<4> covectors, Size count)
{
    const Plan<double> *p = &model->plan;
    ComputedSteps s = steps_of(steps, *p, -1);
    const double *seed[3];
    double *on, *mu, *zeta, *on_defects;
    seeds.maybe(seed[0], {s.k, p->n_q}).maybe(seed[1], {s.k, p->n_q});
    seeds.maybe(seed[2], {s.k, p->n_lam});
    covectors(on, {6, p->n_q})(mu, {s.k, p->n_q})(zeta, {s.k, p->n_lam});
    covectors.maybe(on_defects, {s.k, 3, p->n_q});
    must(count <= s.k, "there are fewer steps");
    int ends = ALL_TAKEN;
    Size left = unlocked([&] {
        return pulled_back(p, &model->room, &s, count, seed, on, mu, zeta, on_defects, &ends);
    });
    return {left, ends};
}

/* ---- equilibria ----------------------------------------------------------------------------- */

template <class T, class M>
std::tuple<int, int, double, int> py_rest(Kept<M> model, Fields<4> state, Fields<4> known,
                                          Fields<3> factors, Array<double> rules)
{
    const Plan<T> *p = &model->plan;
    Size n_q = p->n_q, n_lam = p->n_lam;
    RestProblem<T> own = {};
    RestState<T> to = {};
    state(to.q, {n_q})(to.lam, {n_lam})(to.q_s, {n_q})(to.lam_s, {n_lam});
    known(own.q_0, {n_q}).maybe(own.anchor, {n_q})(own.r_0, {n_q})(own.Phi_0, {n_lam});
    factors(own.of_joints, {p->constraints->n_parts})(own.of_loads, {p->n_factors})(
        own.of_turning, {p->n_factors});
    must(rules.has({sizeof(RestRules) / sizeof(double)}), "there are other rules of equilibria");
    memcpy(&own.rules, rules.data, sizeof own.rules);
    to.size = INFINITY;
    int why = unlocked([&] { return rested<T>(p, &model->room, &own, &to); });
    return {why, to.iterations, to.size, to.definite};
}

/* ---- stages --------------------------------------------------------------------------------- */

/* The coupled matrix of stages: order and scale of unknowns, places of blocks, a band or a function. */
struct CoupledMatrix : OfReals {
    static constexpr const char *NAME = "CoupledMatrix";
    using Arguments =
        std::tuple<Longs, Array<double, 1>, Longs, std::optional<Kept<Band>>, Ref>;
    Arguments of;

    explicit CoupledMatrix(Arguments arguments) : of(std::move(arguments))
    {
        auto &[order, scale, places, band, function] = of;
        must(order.size <= INT_MAX && scale.size == order.size &&
                 within(order, 0, order.size - 1) && within(places, 0, places.size - 1) &&
                 (band ? (*band)->n == order.size : function.get() != Py_None),
             "a coupled matrix must have an order, a scale, and a band or a function");
    }
};

/* The same for a plan, with room. */
struct Coupled {
    std::optional<CalledSolver> solver;
    std::unique_ptr<double[]> reals;
    std::unique_ptr<int[]> pivots;
    StageMatrix matrix = {};

    template <class T> Coupled(const Kept<CoupledMatrix> &x, const Plan<T> &p)
    {
        auto &[order, scale, places, band, function] = x->of;
        StageMatrix *m = &matrix;
        Size n = STAGES * (p.n_q + p.n_lam), width = 0;
        Size n_B = STAGES * p.constraints->n_values, size_K = STAGES * STAGES * p.nnz;
        must(order.size == n && places.size == size_K &&
                 (!band || (*band)->flat().size == size_K + 2 * n_B),
             "the matrix of stages is not that of the plan");
        if (band)
            m->half = (*band)->half, m->flat = (*band)->flat().data,
            m->factors = (*band)->factors(), width = (*band)->width;
        else
            m->solver = &solver.emplace(Ref(Py_NewRef(function.get())), n, size_K, n_B);
        reals = room_for<double>(3 * n + n_B + size_K + n * width);
        pivots = room_for<int>(n);
        m->scale = scale.data, m->order = order.data, m->places = places.data;
        m->gbtrf = gbtrf_of<double>(), m->gbtrs = gbtrs_of<double>(), m->size_K = size_K;
        m->work = reals.get(), m->B = m->work + 3 * n, m->K = m->B + n_B;
        m->band = m->K + size_K, m->pivots = pivots.get();
    }
};

template <class T, class M>
std::tuple<Size, int, Size, Size, Counts, double, double>
py_march_stages(Kept<M> model, Kept<CoupledMatrix> coupled, Fields<4> before,
                std::tuple<Size, double, double> at, Fields<4> control, Ref tolerance,
                std::tuple<Ref, double> laws, Ref along, Fields<5> rows, Fields<2> of_steps,
                Fields<2> settings, double seconds)
{
    const Plan<T> *p = &model->plan;
    Size n_q = p->n_q, n_lam = p->n_lam, n = STAGES * (n_q + n_lam), n_B = p->constraints->n_values;
    Coupled matrix(coupled, *p);
    StageTableau tableau;
    StageRun<T> c{};
    StageStep<T> *s = &c.step;
    before(c.before[0], {&c.n_before, n_q})(c.before[1], {c.n_before, n_q})(
        c.before[2], {c.n_before, n_q})(c.before[3], {c.n_before, n_lam});
    must(c.n_before == 1 || c.n_before == STAGES + 1, "there must be one row, or those of a step");
    take_control(&c, control, of_steps, at);
    Size k = c.filter ? -1 : c.most, of_rows = STAGES * c.most;
    control(c.sizes, {k})(c.known_ends, {k});
    rows(c.instants, {of_rows})(c.rows[0], {of_rows, n_q})(c.rows[1], {of_rows, n_q})(
        c.rows[2], {of_rows, n_q})(c.rows[3], {of_rows, n_lam});
    settings.numbers(tableau).numbers(c.rules);
    std::optional<Items> given;
    c.controlled = tolerance.get() != Py_None;
    must(c.controlled || !c.filter, "a filter needs tolerances");
    if (c.controlled) {
        given.emplace(tolerance.get(), 7);
        for (StepTolerance &each : c.tolerances)
            each.n = n_q, each.rtol = given->take<double>(), (*given)(each.least, {n_q});
        (*given)(c.place, {n_q})(c.scale, {n_q});
        Size d = c.tolerances[0].d = c.tolerances[1].d = given->take<Size>();
        must(d > 0 && n_q % d == 0, "vectors do not fit");
    }
    const double *of = tableau.c;
    CalledLaws<T> of_laws(p, laws, {of[0], of[1], 1, 0}, STAGES * (STAGES + 1), STAGES + 1);
    auto room = room_for<T>(2 * n + STAGES * n_B + n);
    auto reals = room_for<double>(n_B + p->nnz + 10 * n_q);
    s->plan = p, s->room = &model->room, s->matrix = &matrix.matrix;
    s->tableau = &tableau, s->rules = &c.rules;
    s->R = room.get(), s->change = s->R + n, s->B = s->change + n;
    s->x = s->B + STAGES * n_B, s->lam = s->x + STAGES * n_q;
    c.factored = reals.get(), c.reals = c.factored + n_B + p->nnz;
    c.laws = &of_laws, c.along = errors_of(along), c.until = seconds_now() + seconds;
    int why = unlocked([&] { return steps_taken(&c); });
    return {c.taken, why, c.rejected, c.continued, Counts{c.counts[0], c.counts[1], c.counts[2]},
            s->size, c.error};
}

int py_embedded_errors(Kept<Model> model, double h, Fields<4> state, Fields<2> factors, Fields<3> rows,
                       InPlace<double> errors, Array<double, 1> numbers)
{
    const Plan<double> *p = &model->plan;
    Room<double> *r = &model->room;
    Size n_q = p->n_q, n_lam = p->n_lam, n_b;
    const double *q, *v, *a, *lam, *of_joints, *of_loads, *v_b, *a_b, *x_b;
    StageTableau tableau;
    state(q, {n_q})(v, {n_q})(a, {n_q})(lam, {n_lam});
    factors(of_joints, {p->constraints->n_parts})(of_loads, {p->n_factors});
    rows(v_b, {STAGES + 1, &n_b, n_q})(a_b, {n_b, n_q})(x_b, {STAGES, n_b, n_q});
    must(errors.has({2, n_b, n_q}) && numbers.size * sizeof(double) == sizeof tableau,
         "errors must have the shape of rows");
    memcpy(&tableau, numbers.data, sizeof tableau);
    return unlocked([&] {
        StepCoefficients of = of_embedded(&tableau, h);
        std::copy(q, q + n_q, r->q), std::copy(v, v + n_q, r->v);
        std::copy(a, a + n_q, r->A), std::copy(lam, lam + n_lam, r->lam);
        at_instant<double>(p, r, of_joints, 0, 0, r->c);
        jacobian_at<double>(p, r, r->c, q);
        r->exchanging = 0;
        int failed = factorised(p, r, &of, of_loads);
        for (Size b = 0; b < n_b && !failed; b++) {
            const double *v_of[STAGES + 1], *x_of[STAGES];
            for (int i = 0; i <= STAGES; i++)
                v_of[i] = v_b + (i * n_b + b) * n_q;
            for (int i = 0; i < STAGES; i++)
                x_of[i] = x_b + (i * n_b + b) * n_q;
            failed = embedded_error(p, r, &tableau, h, v_of, a_b + b * n_q, x_of,
                                    errors.data + b * n_q, errors.data + (n_b + b) * n_q);
        }
        return failed;
    });
}

/* ---- passes over stages --------------------------------------------------------------------- */

std::tuple<Size, int> py_find_stages(Kept<Model> model, Fields<2> factors, Fields<3> states,
                                     InPlace<double> found, Size first)
{
    const Plan<double> *p = &model->plan;
    const double *of_joints, *of_loads, *q, *V, *A;
    Size k, n = p->n_q + p->n_lam, n_q = p->n_q;
    states(q, {&k, n_q})(V, {k, n_q})(A, {k, n_q});
    factors(of_joints, {p->still ? -1 : 2, p->still ? -1 : k, p->constraints->n_parts})(
        of_loads, {k, p->n_factors});
    must(found.has({k, 2, n}) && first <= k, "there must be a row for each stage");
    int ends = ALL_TAKEN;
    first = unlocked([&] {
        return stages_found(p, &model->room, k, first, of_joints, of_loads, q, V, A, found.data,
                            &ends);
    });
    return {first, ends};
}

/* A pass over steps, with its room: (h, M, Phi_q, f_q, f_v or None, f_q and f_v of completed stages,
 * f_0,q or None, (Phi'_q, Phi''_q) or None, tableau). */
struct PassOverStages {
    Coupled coupled;
    StageTableau tableau;
    ComputedStages stages = {};
    std::unique_ptr<double[]> room;
    StagePass pass = {};

    PassOverStages(Model &model, const Kept<CoupledMatrix> &matrix, Items &x, Size n_b) : coupled(matrix, model.plan)
    {
        const Plan<double> *p = &model.plan;
        ComputedStages *s = &stages;
        x(s->h, {&s->k});
        Size rows = STAGES * s->k, n_B = p->constraints->n_values, nnz = p->nnz;
        Size n = p->n_q + p->n_lam, most = std::max(n_b, (Size)1), each = STAGES * 2 * n;
        x(s->M, {&s->rows_of_M, nnz})(s->Phi_q, {rows, n_B})(s->f_q, {rows, nnz});
        x.maybe(s->f_v, {rows, nnz})(s->end_q, {rows, nnz}).maybe(s->end_v, {rows, nnz});
        x.maybe(s->held_q, {rows, nnz});
        if (Items *rates = x.maybe_part(2))
            (*rates)(s->rate, {rows, n_B})(s->rate_2, {rows, n_B});
        x.numbers(tableau);
        must((s->rows_of_M == 1 || s->rows_of_M == rows) && !s->f_v == !s->end_v,
             "M and f_v must be those of all stages");
        room = room_for<double>(most * p->n_q + n + most * each + most * STAGES * n);
        double *side = room.get() + most * p->n_q, *rows_of = side + n;
        pass = {p, &model.room, &tableau, s, &coupled.matrix, n_b, room.get(), side, rows_of,
                rows_of + most * each};
    }
};

std::tuple<Size, int> py_differentiate_stages(Kept<Model> model, Kept<CoupledMatrix> coupled,
                                              Fields<10> steps, Fields<3> known,
                                              InPlace<double> states, InPlace<double> lam_b,
                                              InPlace<double> x_b, Size first)
{
    const Plan<double> *p = &model->plan;
    must(states.has({-1, 3, -1, p->n_q}), "states must have the shapes of a plan");
    Size n_b = states.length(2);
    PassOverStages over(*model, coupled, steps, n_b);
    Size rows = STAGES * over.stages.k, n = p->n_q + p->n_lam;
    double *given[3];
    for (double *&each : given)
        known(each, {rows, n_b, n});
    must(states.length(0) == rows + 1 && lam_b.has({rows + 1, n_b, p->n_lam}) &&
             x_b.has({rows, n_b, p->n_q}) && STAGES * first <= rows,
         "there must be a row for each stage");
    int ends = ALL_TAKEN;
    first = unlocked([&] {
        return stages_differentiated(&over.pass, first, given, states.data, lam_b.data, x_b.data,
                                     &ends);
    });
    return {first, ends};
}

std::tuple<Size, int> py_pull_back_stages(Kept<Model> model, Kept<CoupledMatrix> coupled, Fields<10> steps,
                                          Fields<3> seeds, InPlace<double> on, Fields<3> covectors,
                                          Size count)
{
    const Plan<double> *p = &model->plan;
    PassOverStages over(*model, coupled, steps, 1);
    Size rows = STAGES * over.stages.k, n = p->n_q + p->n_lam;
    const double *seed[3];
    double *mu[3];
    seeds.maybe(seed[0], {rows, p->n_q}).maybe(seed[1], {rows, p->n_q});
    seeds.maybe(seed[2], {rows, p->n_lam});
    for (double *&each : mu)
        covectors(each, {rows, n});
    must(on.has({2, p->n_q}) && STAGES * count <= rows, "there are fewer steps");
    int ends = ALL_TAKEN;
    count = unlocked([&] {
        return stages_pulled_back(&over.pass, count, seed, on.data, mu[0], mu[1], mu[2], &ends);
    });
    return {count, ends};
}
