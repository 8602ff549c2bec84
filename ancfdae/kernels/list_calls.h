/* What Python calls of formulas: a list of operations, made once, and its values. */

/* Call the function of operation k with rows of inputs, (lanes, n), for rows of its outputs. Where it
 * raises, or something has been raised already, outputs are NaN; `Bound` raises the error. */
void list_called(const Operations *p, Size k, Size lanes, int parts, void *numbers)
{
    const int32_t *call = p->calls + p->a[k], *in = call + 2, *to = in + call[0];
    Size n = call[0], m = call[1];
    double *x = (double *)numbers;
    PyGILState_STATE state = PyGILState_Ensure(); /* marches run without it */
    auto run = [&](auto scalar) -> PyObject * {
        using T = decltype(scalar);
        if (PyErr_Occurred())
            throw Failed();
        auto given = zeros<T>({lanes, n});
        for (Size i = 0; i < lanes; i++)
            for (Size j = 0; j < n; j++)
                given.data[i * n + j] = ((T *)numbers)[in[j] * lanes + i];
        Ref function(Py_NewRef(PyTuple_GetItem((PyObject *)p->functions, p->b[k])));
        Ref rows(given.release());
        Array<T, 2> found(
            made(PyObject_CallFunctionObjArgs(function.get(), rows.get(), nullptr)).get());
        must(found.has({lanes, m}), "a function of a list returns an array of another shape");
        for (Size j = 0; j < m; j++)
            for (Size i = 0; to[j] >= 0 && i < lanes; i++)
                ((T *)numbers)[to[j] * lanes + i] = found.data[i * m + j];
        return Py_None;
    };
    if (!guarded([&] { return parts == 1 ? run(0.0) : run(Complex(0)); }))
        for (Size j = 0; j < m; j++)
            for (Size i = 0; to[j] >= 0 && i < parts * lanes; i++)
                x[parts * to[j] * lanes + i] = NAN;
    PyGILState_Release(state);
}

/* Whether operation k is a call of one of `count` functions, of numbers before it; the array of calls
 * has `size` numbers. */
bool call_fits(const Operations *p, Size k, Size size, Size count)
{
    Size at = p->a[k], own = p->n_inputs + p->n_constants + k;
    if (at < 0 || at + 2 > size || p->b[k] < 0 || p->b[k] >= count)
        return false;
    const int32_t *call = p->calls + at, *in = call + 2;
    if (call[0] < 0 || call[1] < 0 || (Size)call[0] + call[1] > size - at - 2)
        return false;
    for (Size j = 0; j < call[0]; j++)
        if (in[j] < 0 || in[j] >= own)
            return false;
    for (Size j = call[0]; j < (Size)call[0] + call[1]; j++) {
        Size to = in[j] - own + k;
        if (in[j] != -1 &&
            (to <= k || to >= p->n_operations || p->op[to] != RESULT || p->a[to] != own))
            return false;
    }
    return true;
}

/* (n_inputs, constants, op, a, b, outputs, calls, functions) */
struct OperationList {
    static constexpr const char *NAME = "ancfdae.kernels._kernels.OperationList";
    static constexpr const char *MISSING = "plans of lists must have lists of operations";
    using Indices = Array<int32_t, 1>;
    using Arguments =
        std::tuple<Size, Numbers, Indices, Indices, Indices, Indices, Indices, std::vector<Ref>>;
    Arguments of;
    Ref functions;
    Operations list;

    explicit OperationList(Arguments arguments) : of(std::move(arguments))
    {
        auto &[n_inputs, constants, op, a, b, outputs, calls, all_functions] = of;
        must(n_inputs <= NPY_MAX_INT32, "a number of inputs is negative or too large");
        must((bool)constants.in_real, "constants must be real");
        Size ahead = n_inputs + constants.in_real->size, all = ahead + op.size;
        Size count = (Size)all_functions.size();
        functions = made(PyTuple_New(count));
        for (Size i = 0; i < count; i++)
            PyTuple_SetItem(functions.get(), i, all_functions[(size_t)i].release());
        list = {n_inputs,     constants.in_real->size,
                op.size,      outputs.size,
                all,          op.data,
                a.data,       b.data,
                outputs.data, calls.data,
                list_called,  functions.get()};
        bool good = within(op, 0, LIST_OPERATIONS - 1) && a.size == op.size && b.size == op.size &&
                    (outputs.size == 0 || (all > 0 && within(outputs, 0, all - 1)));
        for (Size k = 0; good && k < op.size; k++)
            good = op.data[k] == CALL ? call_fits(&list, k, calls.size, count)
                                      : a.data[k] >= 0 && a.data[k] < ahead + k && b.data[k] >= 0 &&
                                            b.data[k] < ahead + k;
        must(good, "these are not the indices of a list of operations");
    }

    template <class T> const T *constants() const
    {
        const Numbers &x = std::get<1>(of);
        return held_in<T>(*x.in_real, x.in_complex).data;
    }
};

/* ---- lists in the making (trace.h) ---------------------------------------------------------- */

using Places = Array<int32_t, 1>;
using Indexed = Array<int32_t>;

Indexed array_of(const Numbered &numbers)
{
    auto out = zeros<int32_t>({(Size)numbers.size()});
    std::copy(numbers.begin(), numbers.end(), out.data);
    return out;
}

/* (n_inputs): a list without operations. */
struct OperationTrace : Trace {
    static constexpr const char *NAME = "ancfdae.kernels._kernels.OperationTrace";
    static constexpr const char *MISSING = "the first argument must be a list in the making";
    using Arguments = std::tuple<Size>;

    explicit OperationTrace(Arguments arguments) : Trace(std::get<0>(arguments))
    {
        must(std::get<0>(arguments) <= INT_MAX / 2, "a number of inputs is too large");
    }
    void require(const int32_t *numbers, Size count) const
    {
        for (Size i = 0; i < count; i++)
            must(numbers[i] < size() && numbers[i] >= -(Size)constants.size(),
                 "these are not numbers of the list");
    }
};

int py_trace_constant(Kept<OperationTrace> trace, double re, double im)
{
    return trace->constant({re, im});
}

std::tuple<double, double> py_trace_value(Kept<OperationTrace> trace, int32_t number)
{
    must(number < 0, "a constant has a number below zero");
    trace->require(&number, 1);
    Complex x = trace->value(number);
    return {x.re, x.im};
}

int py_trace_apply(Kept<OperationTrace> trace, int32_t op, int32_t x, int32_t y)
{
    const int32_t both[] = {x, y};
    must(op >= 0 && op < OPERATIONS, "there is no operation of this number");
    trace->require(both, 2);
    return trace->apply(op, x, y);
}

int py_trace_power(Kept<OperationTrace> trace, int32_t x, double n)
{
    trace->require(&x, 1);
    return trace->power(x, n);
}

int py_trace_call(Kept<OperationTrace> trace, Places inputs, Size size)
{
    trace->require(inputs.data, inputs.size);
    must(size < INT_MAX / 4, "a function has too many results");
    return trace->call(Numbered(inputs.data, inputs.data + inputs.size), size);
}

/* Rows of rates of outputs in directions, each a row of rates of all inputs. */
Indexed py_trace_along(Kept<OperationTrace> trace, Places outputs, Array<int32_t, 2> rates,
                              Ref of_call)
{
    Size n = trace->n_inputs, count = outputs.size, rows = rates.rows(1);
    must(rates.has({-1, n}), "a direction must have a rate for each input");
    trace->require(outputs.data, count);
    trace->require(rates.data, rates.size);
    auto out = zeros<int32_t>({rows, count});
    Numbered all = trace->needed(outputs.data, count);
    auto called = [&](int32_t index, const Numbered &moved) {
        Ref number = made(PyLong_FromLong(index)), given(array_of(moved).release());
        Places found(made(PyObject_CallFunctionObjArgs(of_call.get(), number.get(), given.get(),
                                                       nullptr)).get());
        must(found.size == trace->calls[(size_t)index].size || found.size == 0,
             "rates must be those of all results of a call");
        trace->require(found.data, found.size);
        return Numbered(found.data, found.data + found.size);
    };
    int32_t zero = trace->constant(0);
    for (Size r = 0; r < rows; r++) {
        const int32_t *own = rates.data + r * n;
        Numbered of_all = trace->along(all, Numbered(own, own + n), called);
        for (Size i = 0; i < count; i++)
            out.data[r * count + i] =
                outputs.data[i] < 0 ? zero : of_all[(size_t)outputs.data[i]];
    }
    return out;
}

Indexed py_trace_partials(Kept<OperationTrace> trace, int32_t output)
{
    trace->require(&output, 1);
    return array_of(trace->partials(output));
}

/* How many operations and constants there are. */
std::tuple<Size, Size> py_trace_sizes(Kept<OperationTrace> trace)
{
    return {(Size)trace->operations.size(), (Size)trace->constants.size()};
}

/* Rows of the operations that outputs follow from: number, operation and both its numbers. */
Indexed py_trace_rows(Kept<OperationTrace> trace, Places outputs)
{
    trace->require(outputs.data, outputs.size);
    Numbered all = trace->needed(outputs.data, outputs.size);
    auto out = zeros<int32_t>({(Size)all.size(), 4});
    for (size_t k = 0; k < all.size(); k++) {
        auto [op, x, y] = trace->of(all[k]);
        const int32_t row[] = {all[k], op, x, y};
        std::copy(row, row + 4, out.data + 4 * k);
    }
    return out;
}

/* Inputs that outputs follow from. */
Indexed py_trace_inputs(Kept<OperationTrace> trace, Places outputs)
{
    trace->require(outputs.data, outputs.size);
    std::vector<char> used((size_t)trace->n_inputs);
    auto note = [&](int32_t x) {
        if (x >= 0 && x < trace->n_inputs)
            used[(size_t)x] = 1;
    };
    for (int32_t z : trace->needed(outputs.data, outputs.size))
        trace->for_operands(z, note);
    std::for_each(outputs.data, outputs.data + outputs.size, note);
    Numbered all;
    for (size_t x = 0; x < used.size(); x++)
        if (used[x])
            all.push_back((int32_t)x);
    return array_of(all);
}

/* Constants, operations with both their numbers, outputs, calls, and which functions these call: what
 * an `OperationList` of some inputs is made of, counted in the order of these, of constants and of
 * results; what outputs do not follow from is left out. */
std::tuple<Array<Complex>, Indexed, Indexed, Indexed, Indexed, Indexed, Indexed>
py_trace_placed(Kept<OperationTrace> trace, Places outputs, Places inputs)
{
    trace->require(outputs.data, outputs.size);
    trace->require(inputs.data, inputs.size);
    Numbered all = trace->needed(outputs.data, outputs.size), place((size_t)trace->size(), -1);
    Numbered of_constant(trace->constants.size(), -1), kept, op, a, b, to, calls, functions;
    auto note = [&](int32_t x) {
        if (x < 0)
            of_constant[(size_t)(-x - 1)] = 0;
    };
    for (int32_t z : all)
        trace->for_operands(z, note);
    std::for_each(outputs.data, outputs.data + outputs.size, note);
    int32_t next = 0;
    for (Size i = 0; i < inputs.size; i++)
        place[(size_t)inputs.data[i]] = next++;
    for (size_t i = 0; i < of_constant.size(); i++)
        if (of_constant[i] == 0)
            of_constant[i] = next++, kept.push_back(-(int32_t)i - 1);
    for (int32_t z : all)
        place[(size_t)z] = next++;
    auto at = [&](int32_t x) {
        int32_t found = x < 0 ? of_constant[(size_t)(-x - 1)] : place[(size_t)x];
        must(found >= 0, "outputs follow from other inputs");
        return found;
    };
    for (int32_t z : all) {
        auto [code, x, y] = trace->of(z);
        op.push_back(code);
        if (code != CALL) {
            a.push_back(at(x)), b.push_back(at(code == RESULT ? x : y));
            continue;
        }
        const TraceCall &own = trace->calls[(size_t)x];
        a.push_back((int32_t)calls.size()), b.push_back((int32_t)functions.size());
        functions.push_back(x);
        calls.push_back((int32_t)own.inputs.size()), calls.push_back(own.size);
        for (int32_t input : own.inputs)
            calls.push_back(at(input));
        for (int32_t i = 0; i < own.size; i++)
            calls.push_back(place[(size_t)(z + 1 + i)]);
    }
    for (Size i = 0; i < outputs.size; i++)
        to.push_back(at(outputs.data[i]));
    auto constants = zeros<Complex>({(Size)kept.size()});
    for (size_t i = 0; i < kept.size(); i++)
        constants.data[i] = trace->value(kept[i]);
    return {std::move(constants), array_of(op), array_of(a),     array_of(b),
            array_of(to),         array_of(calls), array_of(functions)};
}

/* Outputs at inputs in consecutive parts: a row for each time point, or one row for all. */
template <class T> Array<T> py_list_values(Kept<OperationList> of, Rest<Array<T, 1>> parts)
{
    const Operations *p = &of->list;
    std::vector<const T *> from;
    std::vector<Size> step;
    Size rows = -1;
    for (const auto &x : parts) {
        must(x.axes < 3 && (x.axes == 1 || rows < 0 || rows == x.length(0)),
             "parts of inputs must have equally many rows");
        rows = x.axes == 1 ? rows : x.length(0);
        for (Size j = 0; j < x.length(-1); j++)
            from.push_back(x.data + j), step.push_back(x.axes == 1 ? 0 : x.length(-1));
    }
    must((Size)from.size() == p->n_inputs, "there must be a number for each input");
    auto work = room_for<T>(p->n_numbers * LIST_LANES);
    auto out = rows < 0 ? zeros<T>({p->n_outputs}) : zeros<T>({rows, p->n_outputs});
    Size count = rows < 0 ? 1 : rows;
    list_values<T>(p, of->constants<T>(), count, from.data(), step.data(), work.get(), out.data);
    return out;
}

/* ---- accelerations from lists (index_1.h) --------------------------------------------------- */

/* A system of such arguments for states, (2, 1 or 1 + n_b, n), with room for its work. */
struct Index1Model : Index1System {
    std::unique_ptr<double[]> memory;
    std::unique_ptr<int[]> rows_exchanged;

    Index1Model(const std::vector<Kept<OperationList>> &all, const Array<double, 1> &design,
                const Array<double, 1> &scales, const npy_intp *shape)
        : Index1System()
    {
        static const int values[] = {MATRIX, PLACE, SPEED}, changes[] = {SIDES, PLACES, SPEEDS};
        must(all.size() == INDEX_1_LISTS || (all.size() == SIDES && shape[1] == 1),
             "there must be six lists of operations, or three without derivatives");
        for (size_t i = 0; i < all.size(); i++)
            lists[i] = &all[i]->list, constants[i] = all[i]->constants<double>();
        b = design.data, n_b = design.size, rows = shape[1], n = shape[2];
        scale = scales.data, m = scales.size - n;
        Size plain = 1 + 2 * n + n_b, size = n + m;
        bool good = m >= 0 && shape[0] == 2 && (rows == 1 || rows == 1 + n_b);
        for (int i = 0; good && i < 3; i++) {
            const Operations *of = lists[values[i]], *by = lists[changes[i]];
            Size more = 2 * n + n_b + (i == 0 ? size : 0);
            good = of->n_inputs == plain && of->n_outputs == (i == 0 ? n * size + size : m) &&
                   (!by || (by->n_inputs == plain + more && by->n_outputs == (i == 0 ? size : m)));
        }
        must(good, "lists, design, scale and states do not fit together");
        memory = room_for<double>(index_1_room(this) + size);
        rows_exchanged = room_for<int>(size + 1);
        x = memory.get(), K = x + size, numbers = K + size * (size + 1 + 2 * LIST_LANES);
        exchanged = rows_exchanged.get();
    }
};

/* Rows of (a, lam), or with `projected` states moved onto the constraints; else what prevents it. */
Ref py_index_1(std::vector<Kept<OperationList>> lists, Array<double, 1> b, Array<double, 1> scale,
               bool projected, Array<double, 1> t, Array<double, 4> states)
{
    Index1Model s(lists, b, scale, states.shape + states.axes - 3);
    must(states.axes == 4, "states must have four axes");
    must(t.size == states.length(0), "each state must have a time");
    Size count = 2 * s.rows * s.n, size = s.rows * (s.n + s.m);
    auto out = projected ? zeros_like<double>(states, 0, {})
                         : zeros_like<double>(states, 3, {s.rows, s.n + s.m});
    if (projected)
        std::copy(states.data, states.data + states.size, out.data);
    for (Size k = 0; k < t.size; k++) {
        int trouble =
            projected ? index_1_projected(&s, t.data[k], out.data + k * count)
                      : index_1_rows(&s, t.data[k], states.data + k * count, out.data + k * size);
        if (trouble)
            return made(PyLong_FromLong(trouble));
    }
    return Ref(out.release());
}

/* ---- steps of DOP853 (explicit.h) ----------------------------------------------------------- */

struct ListAccelerations : Accelerations {
    Index1Model model;

    ListAccelerations(const std::vector<Kept<OperationList>> &all, const Array<double, 1> &design,
                      const Array<double, 1> &scales, const npy_intp *shape)
        : model(all, design, scales, shape)
    {
        rows = model.rows, n = model.n, m = model.m;
    }
    int solved(double t, const double *state, double *out) override
    {
        return index_1_rows(&model, t, state, out);
    }
    int projected(double t, double *state) override { return index_1_projected(&model, t, state); }
};

/* Accelerations and projected states from functions of Python, which return numbers or what
 * prevents them. */
struct CalledAccelerations : Accelerations {
    Ref of_state, onto_constraints;

    CalledAccelerations(Ref first, Ref second, Size multipliers, const npy_intp *shape)
        : of_state(std::move(first)), onto_constraints(std::move(second))
    {
        rows = shape[1], n = shape[2], m = multipliers;
    }
    int called(const Ref &function, double t, const double *state, double *out, Size count)
    {
        auto given = zeros<double>({2, rows, n});
        std::copy(state, state + given.size, given.data);
        Ref time = made(PyFloat_FromDouble(t)), rows_given(given.release());
        Ref found = made(PyObject_CallFunctionObjArgs(function.get(), time.get(),
                                                      rows_given.get(), nullptr));
        if (PyLong_Check(found.get()))
            return (int)PyLong_AsLong(found.get());
        Array<double> values(found.get());
        must(values.size == count, "a function returns an array of another shape");
        std::copy(values.data, values.data + count, out);
        return all_finite(out, count) ? SOLVED : NOT_FINITE;
    }
    int solved(double t, const double *state, double *out) override
    {
        return called(of_state, t, state, out, rows * (n + m));
    }
    int projected(double t, double *state) override
    {
        return m ? called(onto_constraints, t, state, state, 2 * rows * n) : (int)SOLVED;
    }
};

/* Lists with design and scale, or two functions with the number of multipliers. */
using ListEquations =
    std::tuple<std::vector<Kept<OperationList>>, Array<double, 1>, Array<double, 1>>;
using CalledEquations = std::tuple<Ref, Ref, Size>;
/* Tables of DOP853: factors of stages, (16, 2, 18), of errors, (2, 2, 12), nodes, (16,), and factors
 * of the dense output, (4, 16). */
using ExplicitTables =
    std::tuple<Array<double, 3>, Array<double, 3>, Array<double, 1>, Array<double, 2>>;
/* Rows, states and (a, lam) of a step, and the control, which are written to. */
using ExplicitState = std::tuple<InPlace<double>, InPlace<double>, InPlace<double>, InPlace<double>>;

struct ExplicitModel : ExplicitSteps {
    ExplicitTables tables;
    ExplicitState state;
    std::unique_ptr<Accelerations> equations;
    std::unique_ptr<double[]> memory;
    bool of_lists;

    ExplicitModel(PyObject *of_equations, ExplicitTables all_tables, ExplicitState all_states)
        : tables(std::move(all_tables)), state(std::move(all_states))
    {
        auto &[of_stages, of_errors, at, of_terms] = tables;
        auto &[all_rows, all, all_out, where] = state;
        must(all.axes == 4 && all.has({ALL_STAGES, 2, -1, -1}), "states of stages do not fit");
        const npy_intp *shape = all.shape + 1;
        of_lists = PyTuple_Check(of_equations) && PyTuple_Size(of_equations) == 3 &&
                   PyTuple_Check(PyTuple_GetItem(of_equations, 0));
        if (of_lists) {
            auto [lists, b, scales] = From<ListEquations>::object(of_equations);
            equations = std::make_unique<ListAccelerations>(lists, b, scales, shape);
        } else {
            auto [first, second, m] = From<CalledEquations>::object(of_equations);
            equations =
                std::make_unique<CalledAccelerations>(std::move(first), std::move(second), m, shape);
        }
        of = equations.get();
        Size numbers = of->rows * of->n;
        must(of_stages.has({ALL_STAGES, 2, STEP_ROWS}) && of_errors.has({2, 2, STEP_STAGES}) &&
                 at.has({ALL_STAGES}) && of_terms.has({STAGE_TERMS, ALL_STAGES}),
             "tables do not fit");
        must(all_rows.has({STEP_ROWS, numbers}) &&
                 all_out.has({ALL_STAGES, of->rows, of->n + of->m}) &&
                 where.has({(Size)(sizeof(StepControl) / sizeof(double))}),
             "an array to write to has another shape");
        factors = of_stages.data, errors = of_errors.data, nodes = at.data;
        within = of_terms.data;
        x = all_rows.data, states = all.data, out = all_out.data;
        control = (StepControl *)where.data;
        memory = room_for<double>(2 * numbers * (1 + TERMS));
        scale = memory.get(), terms = scale + 2 * numbers;
    }
};

/* Tolerances: relative, absolute as (2, rows, n), the place of the system, (n,), length of vectors. */
using ExplicitTolerances = std::tuple<double, Array<double, 3>, Array<double, 1>, Size>;
/* Spans, states and multipliers of accepted steps, written to, and which stages they are of. */
using ExplicitKept =
    std::tuple<InPlace<double>, InPlace<double>, InPlace<double>, Array<int32_t, 1>>;

/* Why the march ends, the number of steps, and states at the times that lie behind. */
std::tuple<int, Size, Array<double>>
py_explicit_march(Ref of_equations, ExplicitTables tables, ExplicitState state,
                  ExplicitTolerances tolerances, Array<double, 1> times, double stop, Size count,
                  ExplicitKept kept)
{
    ExplicitModel s(of_equations.get(), std::move(tables), std::move(state));
    auto &[rtol, floor, place, vector] = tolerances;
    auto &[spans, states, lam, used] = kept;
    Size rows = s.of->rows, n = s.of->n;
    must(floor.has({2, rows, n}) && place.has({n}) && vector > 0 && n % vector == 0,
         "tolerances do not fit");
    must(spans.ends({2}) && spans.rows(1) >= count && states.ends({used.size, 2, rows, n}) &&
             states.rows(4) >= count && lam.ends({used.size, rows, s.of->m}) &&
             lam.rows(3) >= count && within(used, 0, ALL_STAGES - 1),
         "there is no room for the steps");
    must(times.size > 0, "there must be a time to reach");
    s.rtol = rtol, s.floor = floor.data, s.place = place.data, s.vector = vector;
    KeptSteps to = {spans.data, states.data, lam.data, used.data, used.size};
    auto room = room_for<double>(times.size * 2 * rows * n);
    RecordedStates recorded = {times.data, times.size, 0, room.get()};
    Size taken = 0;
    int trouble;
    {
        Unlocked others(s.of_lists);
        trouble = explicit_march(&s, times.data[times.size - 1], stop, count, &to, &recorded, &taken);
    }
    auto out = zeros<double>({recorded.done, 2, rows, n});
    std::copy(room.get(), room.get() + out.size, out.data);
    return {trouble, taken, std::move(out)};
}

/* Terms of the dense output of the last step, or what prevents it. */
Ref py_explicit_terms(Ref of_equations, ExplicitTables tables, ExplicitState state)
{
    ExplicitModel s(of_equations.get(), std::move(tables), std::move(state));
    int trouble = explicit_terms(&s);
    if (trouble)
        return made(PyLong_FromLong(trouble));
    auto out = zeros<double>({TERMS, 2, s.of->rows, s.of->n});
    std::copy(s.terms, s.terms + out.size, out.data);
    return Ref(out.release());
}
