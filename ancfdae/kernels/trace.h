/* Lists of operations in the making: what is known already is not listed again, and derivatives are
 * more operations of the same list (`numerics/operations.py`).
 *
 * Numbers are inputs, from 0 on, results, from `n_inputs` on, and constants, from -1 down.
 */

/* Added to a root, and to the base of a negative power, in derivatives: 0/0 becomes 0, and numbers
 * above 1e-134 (1e-184) stay as they are. The derivative of |v| v at v = 0 is then 0. */
const double AT_ROOT = 1e-150, AT_POWER = 1e-200;
/* Whole exponents up to this are written as products: a complex step through `pow` would lose its
 * imaginary part at negative numbers. */
const int PRODUCTS = 64;

using Numbered = std::vector<int32_t>;

/* Places of the inputs of a call, and the number of its results, which stand behind it. */
struct TraceCall {
    Numbered inputs;
    int32_t size;
};

/* What an `OperationList` is made of: constants, operations with both their numbers, outputs, calls,
 * and which functions these call. */
struct PlacedList {
    std::vector<Complex> constants;
    Numbered op, a, b, outputs, calls, functions;
};

struct Trace {
    using Operation = std::array<int32_t, 3>;
    struct Hash {
        size_t operator()(const Operation &x) const
        {
            uint64_t mixed = 0;
            for (int32_t part : x)
                mixed = (mixed ^ (uint32_t)part) * 0x9E3779B97F4A7C15u, mixed ^= mixed >> 29;
            return (size_t)mixed;
        }
    };
    /* Rates of results of call `index`, from its inputs and their rates; nothing if none moves. */
    using Rates = std::function<Numbered(int32_t index, const Numbered &rates)>;

    int32_t n_inputs;
    std::vector<Operation> operations;
    std::vector<Complex> constants;
    std::vector<TraceCall> calls;
    std::unordered_map<Operation, int32_t, Hash> known;
    std::map<std::pair<double, double>, int32_t> known_constants;

    explicit Trace(Size inputs) : n_inputs((int32_t)inputs) {}

    int32_t size() const { return n_inputs + (int32_t)operations.size(); }
    const Operation &of(int32_t number) const { return operations[(size_t)(number - n_inputs)]; }
    Complex value(int32_t number) const { return constants[(size_t)(-number - 1)]; }

    bool holds(const Numbered &numbers) const
    {
        for (int32_t x : numbers)
            if (x >= size() || x < -(Size)constants.size())
                return false;
        return true;
    }

    int32_t constant(Complex x)
    {
        x = {x.re + 0.0, x.im + 0.0}; /* -0 is 0 */
        auto [at, is_new] = known_constants.try_emplace({x.re, x.im}, 0);
        if (is_new) {
            constants.push_back(x);
            at->second = -(int32_t)constants.size();
        }
        return at->second;
    }
    bool is(int32_t number, double x) const { return number < 0 && value(number) == Complex(x); }

    /* Which number is the result already; 0 in `found` if none is. */
    int32_t shortened(int32_t op, int32_t x, int32_t y, bool *found)
    {
        *found = true;
        if (op == MULTIPLY && (is(x, 0) || is(y, 0)))
            return constant(0);
        if (op == MULTIPLY && is(x, 1))
            return y;
        if ((op == MULTIPLY || op == DIVIDE) && is(y, 1))
            return x;
        if (op == ADD && is(x, 0))
            return y;
        if ((op == ADD || op == SUBTRACT) && is(y, 0))
            return x;
        if (op == DIVIDE && is(x, 0))
            return constant(0);
        *found = false;
        return 0;
    }

    Complex folded(int32_t op, Complex x, Complex y)
    {
        double none;
        Complex nothing;
        if (x.im == 0 && y.im == 0) /* else the root of -1 would be a number */
            return operation<double>(op, x.re, y.re, &none, &none);
        return operation<Complex>(op, x, y, &nothing, &nothing);
    }

    /* The number of a result; y is x of operations of one number. */
    int32_t apply(int32_t op, int32_t x, int32_t y)
    {
        Operation key = {op, x, y};
        auto at = known.find(key);
        if (at != known.end())
            return at->second;
        if (x < 0 || y < 0) {
            bool found;
            if (x < 0 && y < 0 && op != ANGLE)
                return constant(folded(op, value(x), value(y)));
            int32_t number = shortened(op, x, y, &found);
            if (found)
                return number;
        }
        operations.push_back(key);
        return known[key] = size() - 1;
    }
    int32_t apply(int32_t op, int32_t x) { return apply(op, x, x); }
    int32_t product(int32_t x, int32_t y) { return apply(MULTIPLY, x, y); }

    /* A call of function `index`; its results stand behind the number that is returned. */
    int32_t call(Numbered inputs, Size results)
    {
        int32_t index = (int32_t)calls.size(), at = size();
        calls.push_back({std::move(inputs), (int32_t)results});
        operations.push_back({CALL, index, index});
        for (int32_t i = 0; i < results; i++)
            operations.push_back({RESULT, at, i});
        return at;
    }

    /* x^n with a constant exponent. */
    int32_t power(int32_t x, double n)
    {
        if (n == 0.5)
            return apply(SQRT, x);
        if (n != std::floor(n) || fabs(n) > PRODUCTS)
            return apply(POWER, x, constant(n));
        if (n < 0)
            return apply(DIVIDE, constant(1), power(x, -n));
        if (n < 2)
            return n == 1 ? x : constant(1);
        int32_t half = power(x, std::floor(n / 2)), whole = apply(SQUARE, half);
        return std::fmod(n, 2) == 1 ? product(whole, x) : whole;
    }

    /* The derivative of result z = f(x, y), from the rates of x and y. */
    int32_t rate(int32_t z, int32_t dx, int32_t dy)
    {
        auto [op, x, y] = of(z);
        int32_t one = constant(1);
        switch (op) {
        case ADD:
        case SUBTRACT: return apply(op, dx, dy);
        case MULTIPLY: {
            int32_t first = product(dx, y);
            return apply(ADD, first, product(x, dy));
        }
        case DIVIDE: return apply(DIVIDE, apply(SUBTRACT, dx, product(z, dy)), y);
        case NEGATE: return apply(NEGATE, dx);
        case ANGLE: {
            int32_t first = product(y, dx), side = apply(SUBTRACT, first, product(x, dy));
            first = product(x, x);
            return apply(DIVIDE, side, apply(ADD, first, product(y, y)));
        }
        case POWER: {
            double n = value(y).re;
            int32_t base = n > 1 ? x : apply(ADD, x, constant(AT_POWER));
            return product(product(y, power(base, n - 1)), dx);
        }
        case SQRT:
            return product(apply(DIVIDE, constant(0.5), apply(ADD, z, constant(AT_ROOT))), dx);
        case EXP: return product(z, dx);
        case LOG: return product(apply(DIVIDE, one, x), dx);
        case SIN: return product(apply(COS, x), dx);
        case COS: return product(apply(NEGATE, apply(SIN, x)), dx);
        case TAN: return product(apply(ADD, one, apply(SQUARE, z)), dx);
        case SINH: return product(apply(COSH, x), dx);
        case COSH: return product(apply(SINH, x), dx);
        case TANH: return product(apply(SUBTRACT, one, apply(SQUARE, z)), dx);
        case ARCTAN:
            return product(apply(DIVIDE, one, apply(ADD, one, apply(SQUARE, x))), dx);
        case SQUARE: return product(product(constant(2), x), dx);
        case POSITIVE: return product(apply(STEP, x), dx);
        case RECIPROCAL: return product(apply(NEGATE, apply(SQUARE, z)), dx);
        }
        return constant(0);
    }

    /* Numbers of the operations that outputs follow from, in their order. */
    Numbered needed(const Numbered &outputs) const
    {
        std::vector<char> found(operations.size());
        Numbered waiting = outputs, all;
        while (!waiting.empty()) {
            int32_t number = waiting.back();
            waiting.pop_back();
            if (number < n_inputs || found[(size_t)(number - n_inputs)])
                continue;
            found[(size_t)(number - n_inputs)] = 1;
            const Operation &own = of(number);
            if (own[0] == CALL) {
                const Numbered &inputs = calls[(size_t)own[1]].inputs;
                waiting.insert(waiting.end(), inputs.begin(), inputs.end());
                continue;
            }
            waiting.push_back(own[1]);
            if (own[0] != RESULT)
                waiting.push_back(own[2]);
        }
        for (size_t k = 0; k < found.size(); k++)
            if (found[k])
                all.push_back(n_inputs + (int32_t)k);
        return all;
    }

    /* Numbers that operations take, with constants. */
    template <class F> void for_operands(int32_t number, F f) const
    {
        const Operation &own = of(number);
        if (own[0] == CALL) {
            for (int32_t x : calls[(size_t)own[1]].inputs)
                f(x);
            return;
        }
        f(own[1]);
        if (own[0] != RESULT)
            f(own[2]);
    }

    /* Rates of all numbers in a direction, in which inputs have `rates`, by `all` operations. */
    Numbered along(const Numbered &all, Numbered rates, const Rates &of_call)
    {
        int32_t zero = constant(0);
        rates.resize((size_t)size(), zero);
        auto at = [&](int32_t x) { return x < 0 ? zero : rates[(size_t)x]; };
        for (int32_t z : all) {
            auto [op, x, y] = of(z);
            if (op == CALL) {
                Numbered inputs = calls[(size_t)x].inputs;
                for (int32_t &input : inputs)
                    input = at(input);
                Numbered found = of_call(x, inputs);
                std::copy(found.begin(), found.end(), rates.begin() + z + 1);
            } else if (op != RESULT && (at(x) != zero || at(y) != zero))
                rates[(size_t)z] = rate(z, at(x), at(y));
        }
        return rates;
    }

    /* Partials of one output by all inputs, written from the output back; it follows from no call. */
    Numbered partials(int32_t output)
    {
        int32_t zero = constant(0), one = constant(1);
        Numbered weights((size_t)size(), zero), all = needed({output});
        if (output >= 0)
            weights[(size_t)output] = one;
        for (size_t k = all.size(); k-- > 0;) {
            int32_t z = all[k], weight = weights[(size_t)z];
            auto [op, x, y] = of(z);
            if (weight == zero)
                continue;
            for (int side = 0; side < (op <= POWER ? 2 : 1); side++) {
                int32_t operand = side ? y : x;
                if (operand < 0)
                    continue;
                int32_t slope = rate(z, side ? zero : one, side ? one : zero);
                int32_t term = product(weight, slope), &to = weights[(size_t)operand];
                to = apply(ADD, to, term);
            }
        }
        weights.resize((size_t)n_inputs);
        return weights;
    }

    /* Inputs that outputs follow from. */
    Numbered inputs(const Numbered &outputs) const
    {
        std::vector<char> used((size_t)n_inputs);
        Numbered all;
        auto note = [&](int32_t x) {
            if (x >= 0 && x < n_inputs)
                used[(size_t)x] = 1;
        };
        for (int32_t z : needed(outputs))
            for_operands(z, note);
        std::for_each(outputs.begin(), outputs.end(), note);
        for (size_t x = 0; x < used.size(); x++)
            if (used[x])
                all.push_back((int32_t)x);
        return all;
    }

    /* A list of some inputs, whose numbers are counted in the order of these, of constants and of
     * results; what outputs do not follow from is left out. False if they follow from other inputs. */
    bool placed(const Numbered &outputs, const Numbered &inputs, PlacedList *to) const
    {
        Numbered all = needed(outputs), place((size_t)size(), -1), of_constant(constants.size(), -1);
        auto note = [&](int32_t x) {
            if (x < 0)
                of_constant[(size_t)(-x - 1)] = 0;
        };
        for (int32_t z : all)
            for_operands(z, note);
        std::for_each(outputs.begin(), outputs.end(), note);
        int32_t next = 0;
        for (int32_t x : inputs)
            if (x < 0)
                return false;
            else
                place[(size_t)x] = next++;
        for (size_t i = 0; i < of_constant.size(); i++)
            if (of_constant[i] == 0)
                of_constant[i] = next++, to->constants.push_back(constants[i]);
        for (int32_t z : all)
            place[(size_t)z] = next++;
        bool good = true;
        auto at = [&](int32_t x) {
            int32_t found = x < 0 ? of_constant[(size_t)(-x - 1)] : place[(size_t)x];
            good &= found >= 0;
            return found;
        };
        for (int32_t z : all) {
            auto [code, x, y] = of(z);
            to->op.push_back(code);
            if (code != CALL) {
                to->a.push_back(at(x)), to->b.push_back(at(code == RESULT ? x : y));
                continue;
            }
            const TraceCall &own = calls[(size_t)x];
            to->a.push_back((int32_t)to->calls.size());
            to->b.push_back((int32_t)to->functions.size());
            to->functions.push_back(x);
            to->calls.push_back((int32_t)own.inputs.size()), to->calls.push_back(own.size);
            for (int32_t input : own.inputs)
                to->calls.push_back(at(input));
            for (int32_t i = 0; i < own.size; i++)
                to->calls.push_back(place[(size_t)(z + 1 + i)]);
        }
        for (int32_t output : outputs)
            to->outputs.push_back(at(output));
        return good;
    }
};
