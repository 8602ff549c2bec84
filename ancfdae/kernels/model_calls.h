/* A system for marches, stages, passes and equilibria: its arrays, checked once, and its room.
 *
 * `__init__.py` says what a plan, a layout of the matrix and the rules hold.
 */

/* A matrix (first, columns, values). */
template <class T> using CsrArguments = std::tuple<Indices, Indices, Array<T, 1>>;

template <class T> Csr<T> csr_of(const CsrArguments<T> &x, Size n, Size n_columns)
{
    auto &[first, columns, values] = x;
    must(n < 0 || first.size == n + 1, "a matrix of a plan has another size");
    check_csr(first, columns, values.size, n_columns);
    return {first.size - 1, first.data, columns.data, values.data};
}

/* A scene: (block, places, M, K, gravity, loads, weights, inverse, constraints, B, two functions,
 * loads that move, each with whether it uses velocities, and which of them turn). */
template <class T>
using SceneArguments =
    std::tuple<BlockArguments<T>, Indices, CsrArguments<T>, CsrArguments<T>, Array<T>, Array<T, 2>,
               Array<double>, Array<double>, Kept<ConstraintPlan>, CsrArguments<double>, Ignored,
               Ignored, std::vector<std::tuple<Kept<LoadPlan>, bool>>, Ignored>;
/* A system of lists: (lists, b, weights, inverse, B, K, whether forces use velocities), and a time
 * that has been added to all that come. */
template <class T>
using ListArguments =
    std::tuple<std::vector<Kept<OperationList>>, Array<T, 1>, Array<double>, Array<double>,
               CsrArguments<double>, CsrArguments<double>, bool, Ignored>;
/* The same of functions of Python: (functions, weights, inverse, B, K, velocities). */
using CalledArguments = std::tuple<std::vector<Ref>, Array<double>, Array<double>,
                                   CsrArguments<double>, CsrArguments<double>, bool>;
/* (order, scale, envelope, band, fronts): an envelope is (first, chosen, places, signs), a band
 * (half, flat, factors), and fronts (chosen, places, arrays). */
using LayoutArguments =
    std::tuple<Longs, Array<double>,
               std::optional<std::tuple<Indices, Indices, Indices, Array<double>>>,
               std::optional<std::tuple<Size, Longs, Array<double>>>,
               std::optional<std::tuple<Indices, Indices, FrontArguments>>>;

/* While this lives, Python may be run. */
class Locked
{
    PyGILState_STATE state = PyGILState_Ensure();

  public:
    ~Locked() { PyGILState_Release(state); }
};

template <class T> Ref copied(Size n, const T *x)
{
    auto array = zeros<T>({n});
    std::copy(x, x + n, array.data);
    return Ref(array.release());
}

Ref number_of(double x) { return made(PyFloat_FromDouble(x)); }

/* What a function returns for these arguments. */
template <class... A> Ref called(PyObject *function, const A &...arguments)
{
    return made(PyObject_CallFunctionObjArgs(function, arguments.get()..., nullptr));
}

/* Equations that functions of Python evaluate: mass, Phi_q, Phi or its rate, Q, (f_q, f_v or None),
 * and loads that turn with their derivative. Where T is double the real parts of what they return
 * count. */
template <class T> struct Called final : Equations<T> {
    enum { MASS, JACOBIAN, CONSTRAINT, FORCE, TANGENTS, FOLLOWING, FUNCTIONS };
    PyObject *of[FUNCTIONS];
    Size n_q, n_lam, n_B, nnz;

    static void taken(Ref found, Size n, T *to)
    {
        if (std::is_same<T, double>::value && is_complex(found.get()))
            found = made(PyObject_GetAttrString(found.get(), "real"));
        Array<T> x(found.get());
        must(x.size == n, "a function of a system returns an array of another size");
        std::copy(x.data, x.data + n, to);
    }

    void mass(const T *q, T *M) override
    {
        Locked python;
        taken(called(of[MASS], copied(n_q, q)), nnz, M);
    }
    void jacobian(T t, const T *q, T *B) override
    {
        Locked python;
        taken(called(of[JACOBIAN], number_of(real_part(t)), copied(n_q, q)), n_B, B);
    }
    void constraint(T t, const T *q, const T *v, T *Phi) override
    {
        Locked python;
        Ref time = number_of(real_part(t)), place = copied(n_q, q);
        taken(v ? called(of[CONSTRAINT], time, place, copied(n_q, v))
                : called(of[CONSTRAINT], time, place),
              n_lam, Phi);
    }
    void force(T t, const T *q, const T *v, T *Q) override
    {
        Locked python;
        taken(called(of[FORCE], number_of(real_part(t)), copied(n_q, q), copied(n_q, v)), n_q, Q);
    }
    void tangents(T t, const T *q, const T *v, const T *A, const T *lam, T *f_q, T *f_v) override
    {
        Locked python;
        Ref found = called(of[TANGENTS], number_of(real_part(t)), copied(n_q, q), copied(n_q, v),
                           copied(n_q, A), copied(n_lam, lam));
        auto parts = From<std::tuple<Ref, Ref>>::object(found.get());
        taken(std::move(std::get<0>(parts)), nnz, f_q);
        if (std::get<1>(parts).get() != Py_None)
            taken(std::move(std::get<1>(parts)), nnz, f_v);
    }
    bool following(T t, const T *q, T *P, T *P_q) override
    {
        Locked python;
        Ref found = called(of[FOLLOWING], number_of(real_part(t)), copied(n_q, q));
        auto parts = From<std::tuple<Ref, Ref>>::object(found.get());
        taken(std::move(std::get<0>(parts)), n_q, P);
        if (P_q)
            taken(std::move(std::get<1>(parts)), nnz, P_q);
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
    ~CalledSolver() override = default;
    bool fails(int terms, const double *numbers, const double *const *values,
               const double *B) override
    {
        Locked python;
        Ref sum = made(PyTuple_New(terms));
        for (int i = 0; i < terms; i++) {
            PyObject *term = Py_BuildValue("(dN)", numbers[i], copied(nnz, values[i]).release());
            PyTuple_SetItem(sum.get(), i, made(term).release());
        }
        factors = called(function.get(), sum, copied(n_B, B));
        return factors.get() == Py_None;
    }
    void solve(bool transposed, Size rows, const double *right, double *x) override
    {
        Locked python;
        Ref turn(Py_NewRef(transposed ? Py_True : Py_False));
        for (Size i = 0; i < rows; i++) {
            Array<double> found(called(factors.get(), copied(n, right + i * n), turn));
            must(found.size == n, "a function that solves returns an array of another size");
            std::copy(found.data, found.data + n, x + i * n);
        }
    }
};

/* A plan of a system with its room. */
template <class T> struct Planned {
    std::optional<SceneArguments<T>> scene;
    std::optional<ListArguments<T>> lists;
    std::optional<CalledArguments> functions;
    std::vector<MovingLoad<T>> moving;
    Listed<T> listed = {};
    Called<T> callers = {};
    ConstraintTable sizes = {}; /* of a system of one's own */
    Plan<T> plan = {};
    Room<T> room = {};
    std::vector<T> memory;

    Planned(PyObject *x, const Array<double> &rules)
    {
        must(rules.size == sizeof(MarchRules) / sizeof(double), "there are other rules of marches");
        memcpy(&plan.rules, rules.data, sizeof plan.rules);
        Py_ssize_t items = PyTuple_Check(x) ? PyTuple_Size(x) : 0;
        if (items == std::tuple_size<ListArguments<T>>::value)
            take_lists(lists.emplace(From<ListArguments<T>>::object(x)));
        else if (items == std::tuple_size<CalledArguments>::value)
            take_functions(functions.emplace(From<CalledArguments>::object(x)));
        else
            take_scene(scene.emplace(From<SceneArguments<T>>::object(x)));
    }

    void take_scene(SceneArguments<T> &x)
    {
        Plan<T> *p = &plan;
        auto &[block, index, M, K, gravity, loads, weights, inverse, constraints, B, of_joints,
               of_loads, moves, turning] = x;
        const Block<T> &b = block.block;
        const ConstraintTable &c = constraints->plan;
        Size size = (Size)(block.n_y + 1) * block.d;
        constexpr bool in_complex = std::is_same<T, Complex>::value;
        p->block = b, p->block.k = 1;
        p->n_y = block.n_y, p->d = block.d, p->n_q = b.n_q, p->damped = b.tau != nullptr;
        p->M = csr_of<T>(M, p->n_q, p->n_q), p->K = csr_of<T>(K, p->n_q, p->n_q),
        p->nnz = std::get<2>(K).size;
        must(index.size == b.n * size * size && within(index, 0, p->nnz - 1),
             "an index of a plan is too large");
        p->index = index.data;
        must(gravity.size == p->n_q && weights.size == p->n_q && inverse.size == p->n_q &&
                 loads.has({-1, p->n_q}),
             "gravity, loads and weights must have a number for each coordinate");
        p->gravity = gravity.data, p->weights = weights.data, p->inverse = inverse.data;
        p->loads = loads.data, p->n_loads = loads.length(0);
        must((in_complex || !constraints->complex_) && c.n_q == p->n_q && c.n_curved == p->nnz,
             "constraints must be real, and those of the coordinates");
        p->constraints = &c, p->numbers = constraints->template in<T>();
        p->n_lam = c.n_lam, p->still = c.n_parts == 1;
        take_jacobian(B, p->n_lam);
        must(p->B.first[p->n_lam] == c.n_values,
             "there must be a value for each entry of the constraint Jacobian");
        p->velocity = p->damped;
        p->n_factors = p->n_loads;
        for (auto &[load, velocity] : moves) {
            must((in_complex || !load->complex_) && load->plan.n_q == p->n_q &&
                     load->plan.n_values == p->nnz,
                 "loads must be real, and those of the coordinates");
            moving.push_back(
                {&load->plan, *load->template in<T>(), velocity, p->n_factors});
            p->n_factors += 1 + load->plan.n_signals;
            p->velocity |= velocity;
        }
        p->moving = moving.data(), p->n_moving = (Size)moving.size();
    }

    void take_jacobian(const CsrArguments<double> &B, Size rows)
    {
        Csr<double> pattern = csr_of<double>(B, rows, plan.n_q);
        plan.B = {pattern.n, pattern.first, pattern.columns, nullptr};
    }

    /* Sizes of a system of one's own, whose factors are the times. */
    void take_sizes(const Array<double> &weights, const Array<double> &inverse,
                    const CsrArguments<double> &B, const CsrArguments<double> &K, bool velocity)
    {
        Plan<T> *p = &plan;
        Size n = p->n_q = weights.size;
        must(inverse.size == n, "weights and their inverses must have one size");
        p->weights = weights.data, p->inverse = inverse.data, p->velocity = velocity;
        take_jacobian(B, -1);
        Csr<double> pattern = csr_of<double>(K, n, n);
        p->K = {pattern.n, pattern.first, pattern.columns, nullptr};
        p->n_lam = p->B.n, p->nnz = p->K.first[n];
        sizes.n_q = n, sizes.n_lam = p->n_lam, sizes.n_values = p->B.first[p->n_lam];
        p->constraints = &sizes, p->n_factors = sizes.n_parts = 1;
    }

    void take_lists(ListArguments<T> &x)
    {
        auto &[own, b, weights, inverse, B, K, velocity, start] = x;
        take_sizes(weights, inverse, B, K, velocity);
        Size n = plan.n_q, nnz = plan.nnz, n_lam = plan.n_lam;
        Size outputs[] = {sizes.n_values, n_lam, n_lam, n, nnz, (velocity ? 2 : 1) * nnz};
        must(own.size() == MARCH_LISTS, "a plan must have six lists of operations");
        for (size_t i = 0; i < MARCH_LISTS; i++) {
            const Operations *of = listed.of[i] = &own[i]->list;
            listed.constants[i] = own[i]->template constants<T>();
            must(of->n_inputs == 1 + 3 * n + n_lam + b.size && of->n_outputs == outputs[i],
                 "lists must be those of the coordinates");
        }
        listed.b = b.data;
        listed.n_q = n, listed.n_lam = n_lam, listed.n_b = b.size;
        plan.own = &listed;
    }

    void take_functions(CalledArguments &x)
    {
        auto &[own, weights, inverse, B, K, velocity] = x;
        take_sizes(weights, inverse, B, K, velocity);
        must(own.size() == Called<T>::FUNCTIONS, "a plan must have six functions");
        for (size_t i = 0; i < own.size(); i++)
            callers.of[i] = own[i].get();
        callers.n_q = plan.n_q, callers.n_lam = plan.n_lam, callers.nnz = plan.nnz;
        callers.n_B = sizes.n_values;
        plan.own = &callers;
    }

    /* Rooms of states and of what an iteration writes. */
    std::vector<std::pair<T **, Size>> rooms()
    {
        const Plan<T> *p = &plan;
        const ConstraintTable *c = p->constraints;
        Room<T> *r = &room;
        Size n_q = p->n_q, n_lam = p->n_lam, n = n_q + n_lam, of_load = 0;
        for (auto &load : moving)
            of_load = std::max(of_load, load_work<T>(load.plan, load.plan->n_U));
        return {
                {&r->q_p, n_q}, {&r->dq_p, n_q}, {&r->v_p, n_q}, {&r->q, n_q}, {&r->v, n_q},
                {&r->A, n_q}, {&r->a, n_q}, {&r->lam, n_lam}, {&r->U, vectors_room(c, 1)},
                {&r->B, c->n_values}, {&r->Q, n_q}, {&r->inner, n_q}, {&r->reaction, n_q},
                {&r->ahead, n_q}, {&r->start, n_q}, {&r->Phi, n_lam}, {&r->rate, n_lam},
                {&r->defect, n_lam}, {&r->R, n}, {&r->x, n}, {&r->force, n_q},
                {&r->at_end, c->n_c}, {&r->within, 2 * c->n_c}, {&r->mass, p->own ? p->nnz : 0},
                {&r->turned, p->own ? p->nnz : 0}, {&listed.numbers, lists ? listed.room() : 0},
                {&r->of_load, of_load}};
    }

    /* Give room to pointers, one behind the other, and return what is left. */
    T *give_room(const std::vector<std::pair<T **, Size>> &to, Size left)
    {
        Size total = left;
        for (auto &[pointer, size] : to)
            total += size;
        memory.resize((size_t)total);
        T *at = memory.data();
        for (auto &[pointer, size] : to)
            *pointer = at, at += size;
        if (plan.own)
            plan.K.values = room.mass, plan.M = plan.K;
        return at;
    }
};

/* A system at real numbers, with its matrices. */
struct Model : Planned<double> {
    static constexpr const char *NAME = "ancfdae.kernels._kernels.Model";
    static constexpr const char *MISSING = "the first argument must be a model";
    using Arguments = std::tuple<Ref, LayoutArguments, Array<double>, Ref>;

    LayoutArguments layout;
    std::optional<CalledSolver> solver;

    explicit Model(Arguments arguments)
        : Planned<double>(std::get<0>(arguments).get(), std::get<2>(arguments)),
          layout(std::move(std::get<1>(arguments)))
    {
        Ref &function = std::get<3>(arguments);
        Size n = plan.n_q + plan.n_lam;
        if (function.get() != Py_None)
            solver.emplace(std::move(function), n, plan.nnz, plan.constraints->n_values);
        plan.solver = solver ? &*solver : nullptr;
        take_layout();
        give_all_room();
        if (plan.flat)
            plan.gbtrf = gbtrf_of<double>(), plan.gbtrs = gbtrs_of<double>();
    }

    /* Places of the lower triangle in an envelope or in fronts, of `size` numbers. */
    void take_lower(const Indices &chosen, const Indices &places, Size size)
    {
        must(within(chosen, 0, plan.nnz - 1) && within(places, 0, size - 1) &&
                 places.size == chosen.size + plan.constraints->n_values,
             "an index of a plan is too large");
        plan.chosen = chosen.data, plan.n_chosen = chosen.size, plan.places = places.data;
    }

    void take_layout()
    {
        Plan<double> *p = &plan;
        auto &[order, scale, envelope, band, fronts] = layout;
        Size n = p->n_q + p->n_lam;
        must(envelope || band || fronts || solver,
             "a layout must have an envelope, a band or fronts");
        must(order.size == n && within(order, 0, n - 1) && scale.size == n,
             "order and scale must have a number for each unknown");
        p->order = order.data, p->scale = scale.data;
        if (fronts) {
            auto &[chosen, places, of] = *fronts;
            must(of.fronts.n == n, "the fronts are not those of the matrix");
            p->fronts = &of.fronts;
            take_lower(chosen, places, of.fronts.column_at[n]);
        }
        if (envelope) {
            auto &[first, chosen, places, signs] = *envelope;
            Size size = envelope_size(first);
            must(first.size == n + 1 && signs.size == n, "the envelope is not that of the matrix");
            p->first = first.data, p->signs = signs.data;
            take_lower(chosen, places, size);
        }
        if (band) {
            auto &[half, flat, factors] = *band;
            Size size = p->nnz + 2 * p->constraints->n_values;
            must(n <= INT_MAX && half <= MOST_HALF && flat.size == size && factors.size == size &&
                     within(flat, 0, n * (3 * half + 1) - 1),
                 "the band is not that of the matrix");
            p->half = half, p->flat = flat.data, p->factors = factors.data;
        }
    }

    void give_all_room()
    {
        const Plan<double> *p = &plan;
        const Fronts *f = p->fronts;
        Room<double> *r = &room;
        Size n = p->n_q + p->n_lam, lower = f ? f->column_at[n] : 0, most = f ? f->most : 0;
        Size matrix =
            std::max({p->first ? (Size)p->first[n] : 0, p->flat ? n * (3 * p->half + 1) : 0,
                      f ? (Size)f->factor_at[f->count] : 0});
        auto all = rooms();
        all.insert(all.end(), {
                {&r->f_q, p->nnz}, {&r->f_v, p->velocity ? p->nnz : 0},
                {&r->sum, p->flat ? p->nnz : 0}, {&r->matrix, matrix},
                {&r->work, 12 * n + 4 * most}, {&r->in_fronts.a, lower},
                {&r->in_fronts.perturbed, lower}, {&r->in_fronts.scale, f ? n : 0},
                {&r->in_fronts.room, 5 * most}, {&r->in_fronts.stack, f ? f->stack : 0},
                {&r->least, n}, {&r->time_factors, p->n_factors}, {&r->columns, 4 * n}});
        double *left = give_room(all, n + (f ? n : 0));
        r->pivots = (int *)left;
        r->in_fronts.at = (int32_t *)(left + n);
    }
};

/* A system at complex numbers, with a model of their real parts. */
struct ComplexModel : Planned<Complex> {
    static constexpr const char *NAME = "ancfdae.kernels._kernels.ComplexModel";
    static constexpr const char *MISSING = "the first argument must be a complex model";
    using Arguments = std::tuple<Ref, Kept<Model>, Array<double>>;

    Kept<Model> model;

    explicit ComplexModel(Arguments arguments)
        : Planned<Complex>(std::get<0>(arguments).get(), std::get<2>(arguments)),
          model(std::move(std::get<1>(arguments)))
    {
        const Plan<double> &real = model->plan;
        must(real.n_q == plan.n_q && real.n_lam == plan.n_lam && real.nnz == plan.nnz &&
                 real.n_factors == plan.n_factors &&
                 real.constraints->n_values == plan.constraints->n_values &&
                 real.constraints->n_c == plan.constraints->n_c,
             "the model of the real parts is that of another system");
        plan.real = &real, plan.real_room = &model->room;
        give_room(rooms(), 0);
    }
};

const char *const UNFIT = "states, tables and rows must have the shapes of a plan";

using Counts = std::tuple<Size, Size, Size>;

/* As many steps as can be taken, from a guess or None, with (tolerance, allowed rate, iterations);
 * returns their number, why it ends, the size of the motion, a, counts, and the size and the slowest
 * rate of the last corrections. */
template <class T, class M>
std::tuple<Size, int, double, Array<T>, Counts, double, double> py_march(
    Kept<M> model, std::tuple<Array<T>, Array<T>, Array<T>, Array<T>, Array<T>> state,
    double motion, Array<double> h, Array<T, 3> of_joints, Array<T, 3> of_loads, double seconds,
    std::tuple<InPlace<T>, InPlace<T>, InPlace<T>, InPlace<T>> rows,
    std::optional<std::tuple<Array<T>, Array<T>>> guess, std::tuple<double, double, Size> limits)
{
    const Plan<T> *p = &model->plan;
    Room<T> *r = &model->room;
    Size k = h.size, n_q = p->n_q, n_lam = p->n_lam;
    auto &[q, v, a, lam, A] = state;
    auto &[of_q, of_v, of_A, of_lam] = rows;
    auto [tolerance, allowed, iterations] = limits;
    must(h.has({k}) && q.has({n_q}) && v.has({n_q}) && a.has({n_q}) && lam.has({n_lam}) &&
             A.has({n_q}) && of_q.has({k, n_q}) && of_v.has({k, n_q}) && of_A.has({k, n_q}) &&
             of_lam.has({k, n_lam}) && of_loads.has({k, 2, p->n_factors}) &&
             of_joints.has({p->still ? -1 : k, -1, p->constraints->n_parts}) &&
             (!guess || (std::get<0>(*guess).has({n_q}) && std::get<1>(*guess).has({n_lam}))),
         UNFIT);
    Size instants = p->still ? +ALL_INSTANTS : of_joints.length(1), steps;
    must(instants >= 2, "a table must tell the factors at both ends of a step");
    auto last = zeros<T>({n_q});
    T *const to[] = {of_q.data, of_v.data, of_A.data, of_lam.data};
    Before<T> b = {q.data, v.data, a.data, lam.data, A.data, motion};
    Attempt<T> how = {nullptr, nullptr, tolerance, allowed, (double)iterations};
    if (guess)
        how.a = std::get<0>(*guess).data, how.lam = std::get<1>(*guess).data;
    Ending ending = {motion, INFINITY, 0};
    int ends = ALL_TAKEN;
    memset(r->counts, 0, sizeof r->counts);
    steps = unlocked([&] { return marched<T>(p, r, &b, k, h.data, instants, of_joints.data, of_loads.data, seconds_now() + seconds, &how, to, last.data, &ends, &ending); });
    return {steps,
            ends,
            b.motion,
            std::move(last),
            Counts{r->counts[0], r->counts[1], r->counts[2]},
            ending.size,
            ending.slowest};
}

/* ---- steps under error control -------------------------------------------------------------- */

StepFilter *filter_of(const InPlace<double> &numbers)
{
    must(numbers.has({sizeof(StepFilter) / sizeof(double)}), "there are other numbers of a filter");
    return (StepFilter *)numbers.data;
}

/* Whether a step is planned (`control.h`), its size and end. */
std::tuple<int, double, double> py_plan_step(InPlace<double> filter, Array<double, 1> stops, double t)
{
    double h = 0, end = t;
    int planned = step_planned(filter_of(filter), stops.size, stops.data, t, &h, &end);
    return {planned, h, end};
}

/* The index of the time point to go on from, or why no step helps; a step without an error was not
 * solved. */
Size py_judge_step(InPlace<double> filter, Size n, double t, double h, std::optional<double> error)
{
    return step_judged(filter_of(filter), n, t, h, error.has_value(), error.value_or(NAN));
}

/* Laws that a function of Python evaluates: of (t, end, h) it returns rows of factors of joints and
 * of loads, and (turn / 1 rad)^order. */
template <class T> struct CalledLaws final : StepLaws<T> {
    using Found = std::tuple<Array<T, 2>, Array<T, 2>, double>;
    const Plan<T> *plan;
    PyObject *function;
    std::optional<Found> found;

    CalledLaws(const Plan<T> *of, PyObject *called, double start)
        : StepLaws<T>(start), plan(of), function(called)
    {
    }
    bool at(const MarchRules *rules, double t, double end, double h, StepTables<T> *to) override
    {
        if (function == Py_None)
            return StepLaws<T>::at(rules, t, end, h, to);
        Locked python;
        return guarded([&]() -> PyObject * {
            Ref tables = called(function, number_of(t), number_of(end), number_of(h));
            found.emplace(From<Found>::object(tables.get()));
            auto &[of_joints, of_loads, turn] = *found;
            must(of_loads.has({2, plan->n_factors}) &&
                     of_joints.has({-1, plan->constraints->n_parts}) &&
                     (plan->still || of_joints.length(0) >= 2),
                 UNFIT);
            *to = {of_joints.data, of_loads.data,
                   plan->still ? +ALL_INSTANTS : of_joints.length(0), turn};
            return Py_None;
        });
    }
};

/* Steps under error control from (q, v, a, lam, A) after step n at time t, by a filter and stops,
 * with (rtol, least sizes, place, numbers of a vector), until rows of (q, v, A, lam), a, ends,
 * sizes of the motion and filters are full; returns the number of steps, why it ends, how many were
 * rejected, counts, and the size of the last correction. */
template <class T, class M>
std::tuple<Size, int, Size, Counts, double> py_march_controlled(
    Kept<M> model, std::tuple<Array<T>, Array<T>, Array<T>, Array<T>, Array<T>> state,
    std::tuple<double, Size, double, double> at, InPlace<double> filter, Array<double, 1> stops,
    std::tuple<double, Array<double>, Array<double>, Size> tolerance,
    std::tuple<Ref, double> laws,
    std::tuple<InPlace<T>, InPlace<T>, InPlace<T>, InPlace<T>> rows,
    std::tuple<InPlace<T>, InPlace<double>, InPlace<double>, InPlace<double>> beside,
    std::tuple<double, Size, double> limits)
{
    const Plan<T> *p = &model->plan;
    Room<T> *r = &model->room;
    auto &[q, v, a, lam, A] = state;
    auto &[of_q, of_v, of_A, of_lam] = rows;
    auto &[of_a, ends, motion, filters] = beside;
    auto &[rtol, least, place, d] = tolerance;
    auto &[function, start] = laws;
    auto [before, n, t, last] = at;
    auto [newton, iterations, seconds] = limits;
    Size k = ends.size, n_q = p->n_q, n_lam = p->n_lam;
    must(q.has({n_q}) && v.has({n_q}) && a.has({n_q}) && lam.has({n_lam}) && A.has({n_q}) &&
             of_q.has({k, n_q}) && of_v.has({k, n_q}) && of_A.has({k, n_q}) &&
             of_lam.has({k, n_lam}) && of_a.has({k, n_q}) && ends.has({k}) && motion.has({k}) &&
             filters.has({k, sizeof(StepFilter) / sizeof(double)}) && least.has({n_q}) &&
             place.has({n_q}) && d > 0 && n_q % d == 0 &&
             (function.get() != Py_None || p->own || (p->still && p->n_factors == 0)),
         UNFIT);
    CalledLaws<T> of_laws(p, function.get(), start);
    Attempt<T> how = {nullptr, nullptr, newton, INFINITY, (double)iterations};
    ControlledRun<T> c = {p, r, filter_of(filter), &of_laws, &how, stops.size, d, n, k, stops.data,
                          least.data, place.data, rtol, t, last, seconds_now() + seconds,
                          {q.data, v.data, a.data, lam.data, A.data, before},
                          {of_q.data, of_v.data, of_A.data, of_lam.data}, of_a.data, ends.data,
                          motion.data, (StepFilter *)filters.data, 0, 0, {before, INFINITY, 0}};
    memset(r->counts, 0, sizeof r->counts);
    int why;
    why = unlocked([&] { return controlled<T>(&c); });
    return {c.taken, why, c.rejected, Counts{r->counts[0], r->counts[1], r->counts[2]},
            c.ending.size};
}

/* ---- passes --------------------------------------------------------------------------------- */

/* (h, q, v, lam, of_joints, of_loads, matrices) of k steps; (M, f_q, f_v or None, Phi_q) there, for
 * a system of one's own; and (which are small, G, g), if any is. */
using StepArguments = std::tuple<
    InPlace<double>, InPlace<double>, InPlace<double>, InPlace<double>, InPlace<double>,
    InPlace<double>, InPlace<double>,
    std::optional<std::tuple<Array<double>, Array<double>, Maybe<double>, Array<double>>>,
    std::optional<std::tuple<Array<int32_t>, Array<double>, Array<double>>>>;

ComputedSteps steps_of(const StepArguments &x, const Plan<double> &p)
{
    auto &[h, q, v, lam, of_joints, of_loads, matrices, local, small] = x;
    Size k = h.size, n_B = p.constraints->n_values;
    must(h.has({k}) && q.has({k, p.n_q}) && v.has({k, p.n_q}) && lam.has({k, p.n_lam}) &&
             of_joints.has({p.still ? -1 : k, p.constraints->n_parts}) &&
             of_loads.has({k, p.n_factors}) && matrices.has({k, 6, 4}) &&
             local.has_value() == (p.own != nullptr),
         UNFIT);
    ComputedSteps s = {};
    s.k = k, s.h = h.data, s.q = q.data, s.v = v.data, s.lam = lam.data;
    s.of_joints = of_joints.data, s.of_loads = of_loads.data, s.matrices = matrices.data;
    if (local) {
        auto &[M, f_q, f_v, Phi_q] = *local;
        must(M.ends({p.nnz}) && (M.rows(1) == 1 || M.rows(1) == k) && f_q.has({k, p.nnz}) &&
                 f_v.has_value() == (p.velocity != 0) && (!f_v || f_v->has({k, p.nnz})) &&
                 Phi_q.has({k, n_B}),
             UNFIT);
        s.M = M.data, s.rows_of_M = M.rows(1), s.f_q = f_q.data, s.f_v = data_of(f_v);
        s.Phi_q = Phi_q.data;
    }
    if (small) {
        auto &[which, G, g] = *small;
        must(which.has({k}) && G.has({k, n_B}) && g.has({k, p.n_lam, -1}), UNFIT);
        s.small = which.data, s.G = G.data, s.g = g.data;
    }
    return s;
}

/* How many steps from step `first` on are differentiated, and why it ends. */
std::tuple<Size, int> py_differentiate_steps(Kept<Model> model, StepArguments steps,
                                             InPlace<double> right, InPlace<double> z,
                                             InPlace<double> states, InPlace<double> lam_b,
                                             Size first)
{
    const Plan<double> *p = &model->plan;
    ComputedSteps s = steps_of(steps, *p);
    auto &small = std::get<8>(steps);
    must(z.has({4, -1, p->n_q}), UNFIT);
    Size n = p->n_q + p->n_lam, n_b = z.length(1), taken;
    must(right.has({s.k, n_b, n}) && states.has({s.k + 1, 3, n_b, p->n_q}) &&
             lam_b.has({s.k, n_b, p->n_lam}) && first <= s.k &&
             (!small || std::get<2>(*small).length(2) == n_b),
         UNFIT);
    auto work = room_for<double>(n_b * n);
    int ends = ALL_TAKEN;
    taken = unlocked([&] { return differentiated(p, &model->room, &s, first, n_b, right.data, z.data, states.data, lam_b.data, work.get(), &ends); });
    return {taken, ends};
}

/* How many of the first `count` steps are left, from the last one back, and why it ends. */
using Seed = std::optional<InPlace<double>>;
std::tuple<Size, int> py_pull_back_steps(Kept<Model> model, StepArguments steps,
                                         std::tuple<Seed, Seed, Seed> seeds, InPlace<double> on,
                                         InPlace<double> mu, InPlace<double> zeta, Seed on_defects,
                                         Size count)
{
    const Plan<double> *p = &model->plan;
    ComputedSteps s = steps_of(steps, *p);
    auto &[on_q, on_v, on_lam] = seeds;
    must((!on_q || on_q->has({s.k, p->n_q})) && (!on_v || on_v->has({s.k, p->n_q})) &&
             (!on_lam || on_lam->has({s.k, p->n_lam})) && on.has({6, p->n_q}) &&
             mu.has({s.k, p->n_q}) && zeta.has({s.k, p->n_lam}) &&
             (!on_defects || on_defects->has({s.k, 3, p->n_q})) && count <= s.k,
         UNFIT);
    const double *const given[] = {data_of(on_q), data_of(on_v), data_of(on_lam)};
    int ends = ALL_TAKEN;
    Size left;
    left = unlocked([&] { return pulled_back(p, &model->room, &s, count, given, on.data, mu.data, zeta.data, data_of(on_defects), &ends); });
    return {left, ends};
}

/* ---- equilibria ----------------------------------------------------------------------------- */

/* Newton's method from a state (q, lam, q_s, lam_s), written in place, with (q_0, anchor or None,
 * r_0, Phi_0): why it ends, iterations, the size of the last correction, and whether K is known to
 * be positive definite there. */
template <class T, class M>
std::tuple<int, int, double, int>
py_rest(Kept<M> model, std::tuple<InPlace<T>, InPlace<T>, InPlace<T>, InPlace<T>> state,
        std::tuple<Array<T>, Maybe<T>, Array<T>, Array<T>> known,
        std::tuple<Array<T>, Array<T>, Array<T>> factors, Array<double> rules)
{
    const Plan<T> *p = &model->plan;
    Size n_q = p->n_q, n_lam = p->n_lam;
    auto &[q, lam, q_s, lam_s] = state;
    auto &[q_0, anchor, r_0, Phi_0] = known;
    auto &[of_joints, of_loads, of_turning] = factors;
    must(q.has({n_q}) && lam.has({n_lam}) && q_s.has({n_q}) && lam_s.has({n_lam}) &&
             q_0.has({n_q}) && (!anchor || anchor->has({n_q})) && r_0.has({n_q}) &&
             Phi_0.has({n_lam}) && of_joints.has({p->constraints->n_parts}) &&
             of_loads.has({p->n_factors}) && of_turning.has({p->n_factors}) &&
             rules.has({sizeof(RestRules) / sizeof(double)}),
         UNFIT);
    RestProblem<T> own = {{},         q_0.data,       data_of(anchor), r_0.data,
                          Phi_0.data, of_joints.data, of_loads.data,   of_turning.data};
    RestState<T> to = {q.data, lam.data, q_s.data, lam_s.data, INFINITY, 0, 0};
    memcpy(&own.rules, rules.data, sizeof own.rules);
    int why;
    why = unlocked([&] { return rested<T>(p, &model->room, &own, &to); });
    return {why, to.iterations, to.size, to.definite};
}

/* ---- stages --------------------------------------------------------------------------------- */

/* (order, scale, places, (half, flat, factors) or None, a function that factorises or None). */
using CoupledArguments =
    std::tuple<Longs, Array<double>, Longs,
               std::optional<std::tuple<Size, Longs, Array<double>>>, Ref>;

/* The coupled matrix of stages of a plan, with its room. */
struct Coupled {
    std::optional<CalledSolver> solver;
    std::unique_ptr<double[]> reals;
    std::unique_ptr<int[]> pivots;
    StageMatrix matrix = {};

    template <class T> Coupled(CoupledArguments &x, const Plan<T> &p)
    {
        auto &[order, scale, places, band, function] = x;
        StageMatrix *m = &matrix;
        Size n = STAGES * (p.n_q + p.n_lam), width = 0;
        Size n_B = STAGES * p.constraints->n_values, size_K = STAGES * STAGES * p.nnz;
        must(n <= INT_MAX && scale.has({n}) && order.size == n && within(order, 0, n - 1) &&
                 places.size == size_K && within(places, 0, size_K - 1) &&
                 (band || function.get() != Py_None),
             "the matrix of stages is not that of the plan");
        if (band) {
            auto &[half, flat, factors] = *band;
            must(half <= MOST_HALF && factors.has({size_K + 2 * n_B}) &&
                     flat.size == factors.size && within(flat, 0, n * (3 * half + 1) - 1),
                 "the matrix of stages is not that of the plan");
            m->half = half, m->flat = flat.data, m->factors = factors.data, width = 3 * half + 1;
        } else
            m->solver = &solver.emplace(std::move(function), n, size_K, n_B);
        reals = room_for<double>(3 * n + n_B + size_K + n * width);
        pivots = room_for<int>(n);
        m->scale = scale.data, m->order = order.data, m->places = places.data;
        m->gbtrf = gbtrf_of<double>(), m->gbtrs = gbtrs_of<double>(), m->size_K = size_K;
        m->work = reals.get(), m->B = m->work + 3 * n, m->K = m->B + n_B;
        m->band = m->K + size_K, m->pivots = pivots.get();
    }
};

/* From (q, v, a, lam) before a step: how it ends, size of the last correction, and counts. */
template <class T, class M>
std::tuple<int, double, Counts> py_solve_stages(
    Kept<M> model, CoupledArguments coupled,
    std::tuple<Array<T>, Array<T>, Array<T>, Array<T>> state, InPlace<T> x, InPlace<T> lam,
    Array<T> of_joints, Array<T> of_loads, InPlace<double> tableau, InPlace<double> rules)
{
    const Plan<T> *p = &model->plan;
    Size n_q = p->n_q, n_lam = p->n_lam, n = STAGES * (n_q + n_lam);
    auto &[q, v, a, lam_before] = state;
    Coupled matrix(coupled, *p);
    StageStep<T> s = {};
    must(q.has({n_q}) && v.has({n_q}) && a.has({n_q}) && lam_before.has({n_lam}) &&
             x.has({STAGES, n_q}) && lam.has({STAGES, n_lam}) &&
             (p->still ? of_joints.axes == 2
                       : of_joints.has({STAGES + 1, p->constraints->n_parts})) &&
             of_loads.has({STAGES + 1, p->n_factors}) &&
             tableau.has({sizeof(StageTableau) / sizeof(double)}) &&
             rules.has({sizeof(StageRules) / sizeof(double)}),
         UNFIT);
    auto room = room_for<T>(2 * n + STAGES * p->constraints->n_values);
    s.plan = p, s.room = &model->room, s.matrix = &matrix.matrix;
    s.tableau = (const StageTableau *)tableau.data, s.rules = (const StageRules *)rules.data;
    s.q = q.data, s.v = v.data, s.a = a.data, s.lam_before = lam_before.data;
    s.of_joints = of_joints.data, s.of_loads = of_loads.data, s.x = x.data, s.lam = lam.data;
    s.R = room.get(), s.change = s.R + n, s.B = s.change + n;
    int ends;
    ends = unlocked([&] { return stages_iterated<T>(&s); });
    return {ends, s.size, Counts{s.iterations, s.factorisations, s.stuck}};
}

/* ---- passes over stages --------------------------------------------------------------------- */

/* How many of k stages are found, with those before `first`, and why it ends; (a, lam) and
 * (v - V, sigma) go to rows of `found`. */
std::tuple<Size, int> py_find_stages(Kept<Model> model, InPlace<double> of_joints,
                                     InPlace<double> of_loads, InPlace<double> q,
                                     InPlace<double> V, InPlace<double> A, InPlace<double> found,
                                     Size first)
{
    const Plan<double> *p = &model->plan;
    Size k = q.rows(1), n = p->n_q + p->n_lam;
    must(q.has({k, p->n_q}) && V.alike(q) && A.alike(q) && found.has({k, 2, n}) && first <= k &&
             of_joints.has({p->still ? -1 : 2, p->still ? -1 : k, p->constraints->n_parts}) &&
             of_loads.has({k, p->n_factors}),
         UNFIT);
    int ends = ALL_TAKEN;
    first = unlocked([&] { return stages_found(p, &model->room, k, first, of_joints.data, of_loads.data, q.data, V.data, A.data, found.data, &ends); });
    return {first, ends};
}

/* (h, M, Phi_q, f_q, f_v or None, f_q and f_v of completed stages, f_0,q or None, (Phi'_q, Phi''_q)
 * or None, tableau) of k steps. */
using Values = Maybe<double>;
using StagesArguments =
    std::tuple<Array<double>, Array<double>, Array<double>, Array<double>, Values, Array<double>,
               Values, Values, std::optional<std::tuple<Array<double>, Array<double>>>,
               Array<double>>;

/* A pass over such steps, with its room. */
struct PassOverStages {
    Coupled coupled;
    ComputedStages stages = {};
    std::unique_ptr<double[]> room;
    StagePass pass = {};

    PassOverStages(Model &model, CoupledArguments &matrix, const StagesArguments &x, Size n_b)
        : coupled(matrix, model.plan)
    {
        const Plan<double> *p = &model.plan;
        auto &[h, M, Phi_q, f_q, f_v, end_q, end_v, held_q, rates, tableau] = x;
        Size k = h.size, rows = STAGES * k, n_B = p->constraints->n_values, nnz = p->nnz;
        Size n = p->n_q + p->n_lam;
        auto fits = [&](const Values &of) { return !of || of->has({rows, nnz}); };
        must(h.has({k}) && M.ends({nnz}) && (M.rows(1) == 1 || M.rows(1) == rows) &&
                 Phi_q.has({rows, n_B}) && f_q.has({rows, nnz}) && end_q.has({rows, nnz}) &&
                 fits(f_v) && fits(end_v) && fits(held_q) &&
                 f_v.has_value() == end_v.has_value() &&
                 tableau.has({sizeof(StageTableau) / sizeof(double)}) &&
                 (!rates || (std::get<0>(*rates).has({rows, n_B}) &&
                             std::get<1>(*rates).has({rows, n_B}))),
             UNFIT);
        stages = {k,         M.rows(1),     h.data,         M.data,         Phi_q.data,
                  f_q.data,  end_q.data,    data_of(f_v),   data_of(end_v), data_of(held_q),
                  rates ? std::get<0>(*rates).data : nullptr,
                  rates ? std::get<1>(*rates).data : nullptr};
        Size most = std::max(n_b, (Size)1), each = STAGES * 2 * n;
        room = room_for<double>(most * p->n_q + n + most * each + most * STAGES * n);
        double *side = room.get() + most * p->n_q, *rows_of = side + n;
        pass = {p, &model.room, (const StageTableau *)tableau.data, &stages, &coupled.matrix, n_b,
                room.get(), side, rows_of, rows_of + most * each};
    }
};

/* How many steps are differentiated, with those before `first`, and why it ends. */
std::tuple<Size, int> py_differentiate_stages(
    Kept<Model> model, CoupledArguments coupled, StagesArguments steps,
    std::tuple<InPlace<double>, InPlace<double>, InPlace<double>> known, InPlace<double> states,
    InPlace<double> lam_b, InPlace<double> x_b, Size first)
{
    const Plan<double> *p = &model->plan;
    Size rows = STAGES * std::get<0>(steps).size, n = p->n_q + p->n_lam;
    must(states.has({rows + 1, 3, -1, p->n_q}), UNFIT);
    Size n_b = states.length(2);
    auto &[right, moved, ended] = known;
    must(right.has({rows, n_b, n}) && moved.alike(right) && ended.alike(right) &&
             lam_b.has({rows + 1, n_b, p->n_lam}) && x_b.has({rows, n_b, p->n_q}) &&
             STAGES * first <= rows,
         UNFIT);
    PassOverStages over(*model, coupled, steps, n_b);
    double *const given[] = {right.data, moved.data, ended.data};
    int ends = ALL_TAKEN;
    first = unlocked([&] { return stages_differentiated(&over.pass, first, given, states.data, lam_b.data, x_b.data, &ends); });
    return {first, ends};
}

/* How many of the first `count` steps are left, from the last one back, and why it ends. */
std::tuple<Size, int> py_pull_back_stages(
    Kept<Model> model, CoupledArguments coupled, StagesArguments steps,
    std::tuple<Seed, Seed, Seed> seeds, InPlace<double> on,
    std::tuple<InPlace<double>, InPlace<double>, InPlace<double>> covectors, Size count)
{
    const Plan<double> *p = &model->plan;
    Size rows = STAGES * std::get<0>(steps).size, n = p->n_q + p->n_lam;
    auto &[on_q, on_v, on_lam] = seeds;
    auto &[mu, moved, ended] = covectors;
    must((!on_q || on_q->has({rows, p->n_q})) && (!on_v || on_v->has({rows, p->n_q})) &&
             (!on_lam || on_lam->has({rows, p->n_lam})) && on.has({2, p->n_q}) &&
             mu.has({rows, n}) && moved.alike(mu) && ended.alike(mu) && STAGES * count <= rows,
         UNFIT);
    PassOverStages over(*model, coupled, steps, 1);
    const double *const given[] = {data_of(on_q), data_of(on_v), data_of(on_lam)};
    int ends = ALL_TAKEN;
    count = unlocked([&] { return stages_pulled_back(&over.pass, count, given, on.data, mu.data, moved.data, ended.data, &ends); });
    return {count, ends};
}
