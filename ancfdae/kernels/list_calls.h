/* What Python calls of formulas: a list of operations, made once, and its values. */

/* Call the function of operation k with rows of inputs, (lanes, n), for rows of its outputs. Where it
 * raises, or something has been raised already, outputs are NaN; `Bound` raises the error. */
void list_called(const Operations *p, Size k, Size lanes, int parts, void *numbers)
{
    const int32_t *call = p->calls + p->a[k], *in = call + 2, *to = in + call[0];
    Size n = call[0], m = call[1];
    double *x = (double *)numbers;
    Locked python; /* marches run without it */
    auto run = [&](auto scalar) -> PyObject * {
        using T = decltype(scalar);
        if (PyErr_Occurred())
            throw Failed();
        auto rows = zeros<T>({lanes, n});
        for (Size i = 0; i < lanes; i++)
            for (Size j = 0; j < n; j++)
                rows.data[i * n + j] = ((T *)numbers)[in[j] * lanes + i];
        auto &function = (*(const std::vector<Ref> *)p->functions)[(size_t)p->b[k]];
        Array<T, 2> found(called(function, std::move(rows)));
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
}

struct OperationList : OfReals {
    static constexpr const char *NAME = "OperationList";
    using Arguments =
        std::tuple<Size, Numbers, Indices, Indices, Indices, Indices, Indices, std::vector<Ref>>;
    Arguments of;
    Operations list;

    explicit OperationList(Arguments arguments) : of(std::move(arguments))
    {
        auto &[n_inputs, numbers, op, a, b, outputs, calls, functions] = of;
        must(n_inputs <= NPY_MAX_INT32, "a number of inputs is negative or too large");
        must(!numbers.in_complex, "constants must be real");
        Size ahead = n_inputs + numbers.size, all = ahead + op.size;
        list = {n_inputs, numbers.size, op.size, outputs.size, all,         op.data,
                a.data,   b.data,       outputs.data, calls.data, list_called, &functions};
        must(a.size == op.size && b.size == op.size &&
                 list_fits(&list, calls.size, (Size)functions.size()),
             "these are not the indices of a list of operations");
    }
    template <class T> const T *constants() const { return std::get<1>(of).in<T>(); }
};

/* Outputs at inputs in consecutive parts: a row for each time point, or one row for all. */
template <class T> Array<T> py_values(Kept<OperationList> of, Rest<Array<T, 1>> parts)
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
    list_values<T>(p, of->constants<T>(), rows < 0 ? 1 : rows, from.data(), step.data(), work.get(),
                   out.data);
    return out;
}

/* ---- lists in the making (trace.h) ---------------------------------------------------------- */

struct OperationTrace : Trace, OfReals {
    static constexpr const char *NAME = "OperationTrace";
    using Arguments = std::tuple<Size>;

    explicit OperationTrace(Arguments arguments) : Trace(std::get<0>(arguments))
    {
        must(std::get<0>(arguments) <= INT_MAX / 2, "a number of inputs is too large");
    }
};
using KeptTrace = Kept<OperationTrace>;

void must_hold(const KeptTrace &trace, const Numbered &numbers)
{
    must(trace->holds(numbers), "these are not numbers of the list");
}

int py_constant(KeptTrace trace, double re, double im) { return trace->constant({re, im}); }

std::tuple<double, double> py_value(KeptTrace trace, int32_t number)
{
    must(number < 0, "a constant has a number below zero");
    must_hold(trace, {number});
    Complex x = trace->value(number);
    return {x.re, x.im};
}

int py_apply(KeptTrace trace, int32_t op, int32_t x, int32_t y)
{
    must(op >= 0 && op < OPERATIONS, "there is no operation of this number");
    must_hold(trace, {x, y});
    return trace->apply(op, x, y);
}

int py_power(KeptTrace trace, int32_t x, double n)
{
    must_hold(trace, {x});
    return trace->power(x, n);
}

int py_call(KeptTrace trace, Numbered inputs, Size size)
{
    must_hold(trace, inputs);
    must(size < INT_MAX / 4, "a function has too many results");
    return trace->call(std::move(inputs), size);
}

/* Rows of rates of outputs in directions, each a row of rates of all inputs. */
Array<int32_t> py_along(KeptTrace trace, Numbered outputs, Array<int32_t, 2> rates, Ref of_call)
{
    Size n = trace->n_inputs, count = (Size)outputs.size(), rows = rates.rows(1);
    must(rates.has({-1, n}), "a direction must have a rate for each input");
    must_hold(trace, outputs);
    must_hold(trace, Numbered(rates.data, rates.data + rates.size));
    auto out = zeros<int32_t>({rows, count});
    Numbered all = trace->needed(outputs);
    auto rates_of_call = [&](int32_t index, const Numbered &moved) {
        auto found = From<Numbered>::object(called(of_call, (int)index, moved).get());
        must((Size)found.size() == trace->calls[(size_t)index].size || found.empty(),
             "rates must be those of all results of a call");
        must_hold(trace, found);
        return found;
    };
    int32_t zero = trace->constant(0);
    for (Size r = 0; r < rows; r++) {
        const int32_t *own = rates.data + r * n;
        Numbered of_all = trace->along(all, Numbered(own, own + n), rates_of_call);
        for (Size i = 0; i < count; i++) {
            int32_t output = outputs[(size_t)i];
            out.data[r * count + i] = output < 0 ? zero : of_all[(size_t)output];
        }
    }
    return out;
}

Numbered py_partials(KeptTrace trace, int32_t output)
{
    must_hold(trace, {output});
    return trace->partials(output);
}

std::tuple<Size, Size> py_sizes(KeptTrace trace)
{
    return {(Size)trace->operations.size(), (Size)trace->constants.size()};
}

Array<int32_t> py_rows(KeptTrace trace, Numbered outputs)
{
    must_hold(trace, outputs);
    Numbered all = trace->needed(outputs);
    auto out = zeros<int32_t>({(Size)all.size(), 4});
    for (size_t k = 0; k < all.size(); k++) {
        auto [op, x, y] = trace->of(all[k]);
        const int32_t row[] = {all[k], op, x, y};
        std::copy(row, row + 4, out.data + 4 * k);
    }
    return out;
}

Numbered py_inputs(KeptTrace trace, Numbered outputs)
{
    must_hold(trace, outputs);
    return trace->inputs(outputs);
}

std::tuple<Array<Complex>, Numbered, Numbered, Numbered, Numbered, Numbered, Numbered>
py_placed(KeptTrace trace, Numbered outputs, Numbered inputs)
{
    must_hold(trace, outputs);
    must_hold(trace, inputs);
    PlacedList x;
    must(trace->placed(outputs, inputs, &x), "outputs follow from other inputs");
    return {copied((Size)x.constants.size(), x.constants.data()), x.op, x.a, x.b, x.outputs,
            x.calls, x.functions};
}
