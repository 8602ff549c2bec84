/* A system for marches, stages, passes and equilibria: its arrays, checked once, and its room.
 *
 * `__init__.py` says what a plan, a layout of the matrix and the rules hold.
 */

/* A matrix (first, columns, values). */
using CsrArguments = std::tuple<Indices, Indices, Array<double, 1>>;

Csr<double> csr_of(const CsrArguments &x, Size n, Size n_columns)
{
    auto &[first, columns, values] = x;
    must(n < 0 || first.size == n + 1, "a matrix of a plan has another size");
    check_csr(first, columns, values.size, n_columns);
    return {first.size - 1, first.data, columns.data, values.data};
}

/* A scene: (block, places, M, K, gravity, loads, weights, inverse, constraints, B, two functions,
 * loads that move, each with whether it uses velocities, and which of them turn). */
using SceneArguments =
    std::tuple<BlockArguments<double>, Indices, CsrArguments, CsrArguments, Array<double>,
               Array<double, 2>, Array<double>, Array<double>, Kept<ConstraintPlan>, CsrArguments,
               Ignored, Ignored, std::vector<std::tuple<Kept<LoadPlan>, bool>>, Ignored>;
/* A system of lists: (lists, b, weights, inverse, B, K, whether forces use velocities), and a time
 * that has been added to all that come. */
using ListArguments = std::tuple<std::vector<Kept<OperationList>>, Array<double, 1>, Array<double>,
                                 Array<double>, CsrArguments, CsrArguments, bool, Ignored>;
/* (order, scale, envelope, band, fronts): an envelope is (first, chosen, places, signs), a band
 * (half, flat, factors), and fronts (chosen, places, arrays). */
using LayoutArguments =
    std::tuple<Longs, Array<double>,
               std::optional<std::tuple<Indices, Indices, Indices, Array<double>>>,
               std::optional<std::tuple<Size, Longs, Array<double>>>,
               std::optional<std::tuple<Indices, Indices, FrontArguments>>>;

struct Model {
    static constexpr const char *NAME = "ancfdae.kernels._kernels.Model";
    static constexpr const char *MISSING = "the first argument must be a model";
    using Arguments = std::tuple<Ref, LayoutArguments, Array<double>>;

    std::optional<SceneArguments> scene;
    std::optional<ListArguments> lists;
    LayoutArguments layout;
    std::vector<MovingLoad<double>> moving;
    Listed<double> listed = {};
    ConstraintTable sizes = {}; /* of lists */
    Plan<double> plan = {};
    Room<double> room = {};
    std::vector<double> memory;

    explicit Model(Arguments arguments) : layout(std::move(std::get<1>(arguments)))
    {
        auto &[object, of_layout, rules] = arguments;
        PyObject *x = object.get();
        must(rules.size == sizeof(MarchRules) / sizeof(double), "there are other rules of marches");
        memcpy(&plan.rules, rules.data, sizeof plan.rules);
        if (PyTuple_Check(x) && PyTuple_Size(x) == std::tuple_size<ListArguments>::value)
            take_lists(lists.emplace(From<ListArguments>::object(x)));
        else
            take_scene(scene.emplace(From<SceneArguments>::object(x)));
        take_layout();
        give_room();
        if (plan.listed)
            plan.K.values = room.mass, plan.M = plan.K;
        if (plan.flat)
            plan.gbtrf = gbtrf_of<double>(), plan.gbtrs = gbtrs_of<double>();
    }

    void take_scene(SceneArguments &x)
    {
        Plan<double> *p = &plan;
        auto &[block, index, M, K, gravity, loads, weights, inverse, constraints, B, of_joints,
               of_loads, moves, turning] = x;
        const Block<double> &b = block.block;
        const ConstraintTable &c = constraints->plan;
        Size size = (Size)(block.n_y + 1) * block.d;
        p->block = b, p->block.k = 1;
        p->n_y = block.n_y, p->d = block.d, p->n_q = b.n_q, p->damped = b.tau != nullptr;
        p->M = csr_of(M, p->n_q, p->n_q), p->K = csr_of(K, p->n_q, p->n_q),
        p->nnz = std::get<2>(K).size;
        must(index.size == b.n * size * size && within(index, 0, p->nnz - 1),
             "an index of a plan is too large");
        p->index = index.data;
        must(gravity.size == p->n_q && weights.size == p->n_q && inverse.size == p->n_q &&
                 loads.has({-1, p->n_q}),
             "gravity, loads and weights must have a number for each coordinate");
        p->gravity = gravity.data, p->weights = weights.data, p->inverse = inverse.data;
        p->loads = loads.data, p->n_loads = loads.length(0);
        must(!constraints->complex_ && c.n_q == p->n_q && c.n_curved == p->nnz,
             "constraints must be real, and those of the coordinates");
        p->constraints = &c, p->numbers = constraints->in_real;
        p->n_lam = c.n_lam, p->still = c.n_parts == 1;
        p->B = csr_of(B, p->n_lam, p->n_q);
        must(p->B.first[p->n_lam] == c.n_values,
             "there must be a value for each entry of the constraint Jacobian");
        p->velocity = p->damped;
        for (auto &[load, velocity] : moves) {
            must(!load->complex_ && load->plan.n_q == p->n_q && load->plan.n_values == p->nnz,
                 "loads must be real, and those of the coordinates");
            moving.push_back({&load->plan, load->in_real, velocity});
            p->velocity |= velocity;
        }
        p->moving = moving.data(), p->n_moving = (Size)moving.size();
        p->n_factors = p->n_loads + p->n_moving;
    }

    void take_lists(ListArguments &x)
    {
        Plan<double> *p = &plan;
        auto &[own, b, weights, inverse, B, K, velocity, start] = x;
        Size n = p->n_q = weights.size;
        must(inverse.size == n, "weights and their inverses must have one size");
        p->weights = weights.data, p->inverse = inverse.data, p->velocity = velocity;
        p->B = csr_of(B, -1, n), p->K = csr_of(K, n, n);
        p->n_lam = p->B.n, p->nnz = p->K.first[n];
        sizes.n_q = n, sizes.n_lam = p->n_lam, sizes.n_values = p->B.first[p->n_lam];
        p->constraints = &sizes, p->n_factors = sizes.n_parts = 1;
        Size outputs[] = {
            sizes.n_values, p->n_lam, p->n_lam, n, p->nnz, (velocity ? 2 : 1) * p->nnz};
        must(own.size() == MARCH_LISTS, "a plan must have six lists of operations");
        for (size_t i = 0; i < MARCH_LISTS; i++) {
            const Operations *of = listed.of[i] = &own[i]->list;
            listed.constants[i] = own[i]->constants<double>();
            must(of->n_inputs == 1 + 3 * n + p->n_lam + b.size && of->n_outputs == outputs[i],
                 "lists must be those of the coordinates");
        }
        listed.b = b.data, listed.n_b = b.size;
        p->listed = &listed;
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
        must(envelope || band || fronts, "a layout must have an envelope, a band or fronts");
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

    /* Give room to pointers, one behind the other. */
    void give_room()
    {
        const Plan<double> *p = &plan;
        const ConstraintTable *c = p->constraints;
        const Fronts *f = p->fronts;
        Room<double> *r = &room;
        Size n_q = p->n_q, n_lam = p->n_lam, n = n_q + n_lam, nnz = p->nnz, of_load = 0,
             numbers = 0;
        Size lower = f ? f->column_at[n] : 0, most = f ? f->most : 0;
        Size matrix =
            std::max({p->first ? (Size)p->first[n] : 0, p->flat ? n * (3 * p->half + 1) : 0,
                      f ? (Size)f->factor_at[f->count] : 0});
        for (auto &load : moving)
            of_load = std::max(of_load, load_work<double>(load.plan, load.plan->n_U));
        for (int i = 0; p->listed && i < MARCH_LISTS; i++)
            numbers = std::max(numbers, p->listed->of[i]->n_numbers);
        const std::pair<double **, Size> rooms[] = {{&r->q_p, n_q},
                                                    {&r->dq_p, n_q},
                                                    {&r->v_p, n_q},
                                                    {&r->q, n_q},
                                                    {&r->v, n_q},
                                                    {&r->A, n_q},
                                                    {&r->a, n_q},
                                                    {&r->lam, n_lam},
                                                    {&r->U, 2 * c->most},
                                                    {&r->B, c->n_values},
                                                    {&r->Q, n_q},
                                                    {&r->inner, n_q},
                                                    {&r->reaction, n_q},
                                                    {&r->ahead, n_q},
                                                    {&r->start, n_q},
                                                    {&r->Phi, n_lam},
                                                    {&r->rate, n_lam},
                                                    {&r->defect, n_lam},
                                                    {&r->R, n},
                                                    {&r->x, n},
                                                    {&r->force, n_q},
                                                    {&r->f_q, nnz},
                                                    {&r->f_v, p->velocity ? nnz : 0},
                                                    {&r->sum, p->flat ? nnz : 0},
                                                    {&r->matrix, matrix},
                                                    {&r->work, 12 * n + 4 * most},
                                                    {&r->in_fronts.a, lower},
                                                    {&r->in_fronts.perturbed, lower},
                                                    {&r->in_fronts.scale, f ? n : 0},
                                                    {&r->in_fronts.room, 5 * most},
                                                    {&r->in_fronts.stack, f ? f->stack : 0},
                                                    {&r->at_end, c->n_c},
                                                    {&r->within, 2 * c->n_c},
                                                    {&r->least, n},
                                                    {&r->mass, p->listed ? nnz : 0},
                                                    {&r->numbers, numbers},
                                                    {&r->of_load, of_load}};
        Size total = n + (f ? n : 0);
        for (auto &[to, size] : rooms)
            total += size;
        memory.resize((size_t)total);
        double *at = memory.data();
        for (auto &[to, size] : rooms)
            *to = at, at += size;
        r->pivots = (int *)at;
        r->in_fronts.at = (int32_t *)(at + n);
    }
};

/* A model of a scene. */
struct SceneModel : Kept<Model> {
    explicit SceneModel(PyObject *object) : Kept<Model>(object)
    {
        must(!(**this).plan.listed, "lists of operations only march");
    }
};

const char *const UNFIT = "states, tables and rows must have the shapes of a plan";

using Counts = std::tuple<Size, Size, Size>;

/* As many steps as can be taken; returns their number, why it ends, the size of the motion, a, and
 * counts. */
std::tuple<Size, int, double, Array<double>, Counts> py_march(
    Kept<Model> model,
    std::tuple<Array<double>, Array<double>, Array<double>, Array<double>, Array<double>> state,
    double motion, Array<double> h, Array<double, 3> of_joints, Array<double, 3> of_loads,
    double seconds,
    std::tuple<InPlace<double>, InPlace<double>, InPlace<double>, InPlace<double>> rows)
{
    const Plan<double> *p = &model->plan;
    Room<double> *r = &model->room;
    Size k = h.size, n_q = p->n_q, n_lam = p->n_lam;
    auto &[q, v, a, lam, A] = state;
    auto &[of_q, of_v, of_A, of_lam] = rows;
    must(h.has({k}) && q.has({n_q}) && v.has({n_q}) && a.has({n_q}) && lam.has({n_lam}) &&
             A.has({n_q}) && of_q.has({k, n_q}) && of_v.has({k, n_q}) && of_A.has({k, n_q}) &&
             of_lam.has({k, n_lam}) && of_loads.has({k, 2, p->n_factors}) &&
             of_joints.has({p->still ? -1 : k, -1, p->constraints->n_parts}),
         UNFIT);
    Size instants = p->still ? +ALL_INSTANTS : of_joints.length(1), steps;
    must(instants >= 2, "a table must tell the factors at both ends of a step");
    auto last = zeros<double>({n_q});
    double *const to[] = {of_q.data, of_v.data, of_A.data, of_lam.data};
    Before<double> b = {q.data, v.data, a.data, lam.data, A.data, motion};
    int ends = ALL_TAKEN;
    memset(r->counts, 0, sizeof r->counts);
    {
        Unlocked others;
        steps = marched<double>(p, r, &b, k, h.data, instants, of_joints.data, of_loads.data,
                                seconds_now() + seconds, to, last.data, &ends);
    }
    return {steps, ends, b.motion, std::move(last),
            Counts{r->counts[0], r->counts[1], r->counts[2]}};
}

/* ---- passes --------------------------------------------------------------------------------- */

/* (h, q, v, lam, of_joints, of_loads, matrices) of k steps. */
using StepArguments = std::tuple<InPlace<double>, InPlace<double>, InPlace<double>, InPlace<double>,
                                 InPlace<double>, InPlace<double>, InPlace<double>>;

ComputedSteps steps_of(const StepArguments &x, const Plan<double> &p)
{
    auto &[h, q, v, lam, of_joints, of_loads, matrices] = x;
    Size k = h.size;
    must(h.has({k}) && q.has({k, p.n_q}) && v.has({k, p.n_q}) && lam.has({k, p.n_lam}) &&
             of_joints.has({p.still ? -1 : k, p.constraints->n_parts}) &&
             of_loads.has({k, p.n_factors}) && matrices.has({k, 6, 4}),
         UNFIT);
    return {k, h.data, q.data, v.data, lam.data, of_joints.data, of_loads.data, matrices.data};
}

/* How many steps are differentiated, and why it ends. */
std::tuple<Size, int> py_differentiate_steps(SceneModel model, StepArguments steps,
                                             InPlace<double> right, InPlace<double> z,
                                             InPlace<double> states, InPlace<double> lam_b)
{
    const Plan<double> *p = &model->plan;
    ComputedSteps s = steps_of(steps, *p);
    must(z.has({4, -1, p->n_q}), UNFIT);
    Size n = p->n_q + p->n_lam, n_b = z.length(1), taken;
    must(right.has({s.k, n_b, n}) && states.has({s.k, 3, n_b, p->n_q}) &&
             lam_b.has({s.k, n_b, p->n_lam}),
         UNFIT);
    auto work = room_for<double>(n_b * n);
    int ends = ALL_TAKEN;
    {
        Unlocked others;
        taken = differentiated(p, &model->room, &s, n_b, right.data, z.data, states.data,
                               lam_b.data, work.get(), &ends);
    }
    return {taken, ends};
}

/* How many steps are pulled back, and why it ends. */
using Seed = std::optional<InPlace<double>>;
std::tuple<Size, int> py_pull_back_steps(SceneModel model, StepArguments steps,
                                         std::tuple<Seed, Seed, Seed> seeds, InPlace<double> on,
                                         InPlace<double> mu, InPlace<double> zeta)
{
    const Plan<double> *p = &model->plan;
    ComputedSteps s = steps_of(steps, *p);
    auto &[on_q, on_v, on_lam] = seeds;
    must((!on_q || on_q->has({s.k, p->n_q})) && (!on_v || on_v->has({s.k, p->n_q})) &&
             (!on_lam || on_lam->has({s.k, p->n_lam})) && on.has({6, p->n_q}) &&
             mu.has({s.k, p->n_q}) && zeta.has({s.k, p->n_lam}),
         UNFIT);
    const double *const given[] = {data_of(on_q), data_of(on_v), data_of(on_lam)};
    int ends = ALL_TAKEN;
    Size taken;
    {
        Unlocked others;
        taken = pulled_back(p, &model->room, &s, given, on.data, mu.data, zeta.data, &ends);
    }
    return {taken, ends};
}

/* ---- equilibria ----------------------------------------------------------------------------- */

/* Newton's method from a state (q, lam, q_s, lam_s), written in place, with (q_0, anchor or None,
 * r_0, Phi_0): why it ends, iterations, the size of the last correction, and whether K is known to
 * be positive definite there. */
std::tuple<int, int, double, int>
py_rest(SceneModel model,
        std::tuple<InPlace<double>, InPlace<double>, InPlace<double>, InPlace<double>> state,
        std::tuple<InPlace<double>, Seed, InPlace<double>, InPlace<double>> known,
        std::tuple<InPlace<double>, InPlace<double>, InPlace<double>> factors,
        InPlace<double> rules)
{
    const Plan<double> *p = &model->plan;
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
    RestProblem own = {{},         q_0.data,       data_of(anchor), r_0.data,
                       Phi_0.data, of_joints.data, of_loads.data,   of_turning.data};
    RestState to = {q.data, lam.data, q_s.data, lam_s.data, INFINITY, 0, 0};
    memcpy(&own.rules, rules.data, sizeof own.rules);
    int why;
    {
        Unlocked others;
        why = rested(p, &model->room, &own, &to);
    }
    return {why, to.iterations, to.size, to.definite};
}

/* ---- stages --------------------------------------------------------------------------------- */

/* (order, scale, half, flat, factors, places) of the coupled matrix; (q, v, a, lam) before. Returns
 * how it ends, size of the last correction, and counts. */
std::tuple<int, double, Counts> py_solve_stages(
    Kept<Model> model, std::tuple<Longs, Array<double>, Size, Longs, Array<double>, Longs> coupled,
    std::tuple<InPlace<double>, InPlace<double>, InPlace<double>, InPlace<double>> state,
    InPlace<double> x, InPlace<double> lam, InPlace<double> of_joints, InPlace<double> of_loads,
    InPlace<double> tableau, InPlace<double> rules)
{
    const Plan<double> *p = &model->plan;
    Size n_q = p->n_q, n_lam = p->n_lam, n = STAGES * (n_q + n_lam);
    auto &[order, scale, half, flat, factors, places] = coupled;
    auto &[q, v, a, lam_before] = state;
    Size n_B = STAGES * p->constraints->n_values, size_K = STAGES * STAGES * p->nnz;
    must(half <= MOST_HALF && n <= INT_MAX && scale.has({n}) && factors.has({size_K + 2 * n_B}) &&
             order.size == n && within(order, 0, n - 1) && flat.size == factors.size &&
             within(flat, 0, n * (3 * half + 1) - 1) && places.size == size_K &&
             within(places, 0, size_K - 1),
         "the matrix of stages is not that of the plan");
    must(q.has({n_q}) && v.has({n_q}) && a.has({n_q}) && lam_before.has({n_lam}) &&
             x.has({STAGES, n_q}) && lam.has({STAGES, n_lam}) &&
             (p->still ? of_joints.axes == 2
                       : of_joints.has({STAGES + 1, p->constraints->n_parts})) &&
             of_loads.has({STAGES + 1, p->n_factors}) &&
             tableau.has({sizeof(StageTableau) / sizeof(double)}) &&
             rules.has({sizeof(StageRules) / sizeof(double)}),
         UNFIT);
    Size band = n * (3 * half + 1);
    auto room = room_for<double>(4 * n + n_B + size_K + band);
    auto pivots = room_for<int>(n);
    StageStep s = {};
    s.plan = p, s.room = &model->room;
    s.tableau = (const StageTableau *)tableau.data, s.rules = (const StageRules *)rules.data;
    s.q = q.data, s.v = v.data, s.a = a.data, s.lam_before = lam_before.data;
    s.of_joints = of_joints.data, s.of_loads = of_loads.data;
    s.scale = scale.data, s.factors = factors.data;
    s.order = order.data, s.flat = flat.data, s.places = places.data;
    s.gbtrf = gbtrf_of<double>(), s.gbtrs = gbtrs_of<double>();
    s.half = half, s.size_K = size_K, s.x = x.data, s.lam = lam.data;
    s.R = room.get(), s.change = s.R + n, s.work = s.change + n, s.B = s.work + n;
    s.K = s.B + n_B, s.band = s.K + size_K, s.pivots = pivots.get();
    int ends;
    {
        Unlocked others;
        ends = stages_iterated(&s);
    }
    return {ends, s.size, Counts{s.iterations, s.factorisations, s.stuck}};
}
