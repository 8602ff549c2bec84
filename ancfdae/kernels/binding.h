/* How arguments from Python become those of functions in C++, once for all functions.
 *
 * `Bound<f>::call` converts each argument by its type, calls f and converts what it returns.
 * Arrays are taken in one piece and converted to their type, as NumPy does safely; what does not
 * fit raises ValueError or TypeError. `Either<f, g>` calls g where an argument is complex.
 */

/* Python's error is set. */
struct Failed {
};

[[noreturn]] void wrong(const char *what)
{
    PyErr_SetString(PyExc_ValueError, what);
    throw Failed();
}

void must(bool good, const char *what)
{
    if (!good)
        wrong(what);
}

/* A reference to an object. */
class Ref
{
    PyObject *x;

  public:
    explicit Ref(PyObject *own = nullptr) : x(own) {}
    Ref(Ref &&other) noexcept : x(other.x) { other.x = nullptr; }
    Ref &operator=(Ref &&other) noexcept
    {
        std::swap(x, other.x);
        return *this;
    }
    ~Ref() { Py_XDECREF(x); }
    PyObject *get() const { return x; }
    PyObject *release() { return std::exchange(x, nullptr); }
};

/* The object that a function of Python made, or its error. */
Ref made(PyObject *x)
{
    if (!x)
        throw Failed();
    return Ref(x);
}

/* While this lives, other threads may run Python. */
class Unlocked
{
    PyThreadState *kept;

  public:
    explicit Unlocked(bool much = true) : kept(much ? PyEval_SaveThread() : nullptr) {}
    ~Unlocked()
    {
        if (kept)
            PyEval_RestoreThread(kept);
    }
};

/* What f returns; meanwhile other threads may run Python. */
template <class F> auto unlocked(F f)
{
    Unlocked others;
    return f();
}

template <class T> std::unique_ptr<T[]> room_for(Size size)
{
    return std::unique_ptr<T[]>(new T[(size_t)size]);
}

/* ---- arrays --------------------------------------------------------------------------------- */

template <class T>
constexpr int TYPE = std::is_same<T, double>::value    ? NPY_DOUBLE
                     : std::is_same<T, Complex>::value ? NPY_CDOUBLE
                     : std::is_same<T, int32_t>::value ? NPY_INT32
                                                       : NPY_INT64;

bool is_complex(PyObject *x) { return PyArray_Check(x) && PyArray_ISCOMPLEX((PyArrayObject *)x); }

/* An array in one piece; the axes are counted from the first, negative ones from the last. */
template <class T> class ArrayOf
{
    Ref held;

    void take(int least)
    {
        auto *own = (PyArrayObject *)held.get();
        axes = PyArray_NDIM(own), shape = PyArray_DIMS(own), size = PyArray_SIZE(own);
        data = (T *)PyArray_DATA(own);
        must(axes >= least, "an array has too few axes");
    }

  public:
    int axes;
    Size size;
    const npy_intp *shape;
    T *data;

    NOT_INLINE ArrayOf(PyObject *object, int least, bool in_place)
    {
        auto *own = (PyArrayObject *)object;
        must(object != Py_None, "an array is missing");
        must(!in_place ||
                 (PyArray_Check(object) && PyArray_TYPE(own) == TYPE<T> && PyArray_ISCARRAY(own)),
             "an array to write to has another type or shape, or is not in one piece");
        held = in_place ? Ref(Py_NewRef(object))
                        : made(PyArray_FROM_OTF(object, TYPE<T>, NPY_ARRAY_IN_ARRAY));
        take(least);
    }
    explicit ArrayOf(Ref object) : held(std::move(object)) { take(0); }
    PyObject *release() { return held.release(); }
    Size length(int axis) const { return shape[axis < 0 ? axes + axis : axis]; }
    /* Product of all lengths but the last ones. */
    Size rows(int last) const
    {
        Size product = 1;
        for (int i = 0; i < axes - last; i++)
            product *= shape[i];
        return product;
    }
    /* Whether the last axes have these lengths; negative ones are any. */
    NOT_INLINE bool ends(std::initializer_list<Size> lengths) const
    {
        int axis = axes - (int)lengths.size();
        if (axis < 0)
            return false;
        for (Size length : lengths)
            if (length != shape[axis++] && length >= 0)
                return false;
        return true;
    }
    bool has(std::initializer_list<Size> lengths) const
    {
        return axes == (int)lengths.size() && ends(lengths);
    }
    template <class U> bool alike(const ArrayOf<U> &other) const
    {
        return axes == other.axes && std::equal(shape, shape + axes, other.shape);
    }
};

/* An array with at least AXES axes. */
template <class T, int AXES = 0> struct Array : ArrayOf<T> {
    explicit Array(PyObject *object) : ArrayOf<T>(object, AXES, false) {}
    explicit Array(Ref object) : ArrayOf<T>(std::move(object)) {}
};

/* An array of this type that is written to where it stands. */
template <class T> struct InPlace : ArrayOf<T> {
    explicit InPlace(PyObject *object) : ArrayOf<T>(object, 0, true) {}
};

template <class T, int AXES = 0> using Maybe = std::optional<Array<T, AXES>>;

template <class A> auto data_of(const std::optional<A> &x) { return x ? x->data : nullptr; }

template <class T> NOT_INLINE Array<T> zeros(std::initializer_list<Size> shape)
{
    return Array<T>(
        made(PyArray_ZEROS((int)shape.size(), const_cast<npy_intp *>(shape.begin()), TYPE<T>, 0)));
}

/* Zeros with the axes of an array but its last ones, and then more. */
template <class T, class U>
NOT_INLINE Array<T> zeros_like(const ArrayOf<U> &model, int last, std::initializer_list<Size> more)
{
    std::vector<npy_intp> shape(model.shape, model.shape + (model.axes - last));
    shape.insert(shape.end(), more);
    return Array<T>(made(PyArray_ZEROS((int)shape.size(), shape.data(), TYPE<T>, 0)));
}

/* Whether all numbers lie from `least` to `most`: else x - least or most - x has the bit of the
 * sign. Without branches this costs next to nothing. */
template <class I> NOT_INLINE bool within(const ArrayOf<I> &array, Size least, Size most)
{
    using Bits = std::make_unsigned_t<I>;
    const Size high = std::min(most, (Size)std::numeric_limits<I>::max());
    Bits bits = 0;
    for (Size i = 0; i < array.size; i++)
        bits |= ((Bits)array.data[i] - (Bits)least) | ((Bits)high - (Bits)array.data[i]);
    return bits >> (8 * sizeof(I) - 1) == 0;
}

/* Whether numbers begin at 0, end at `end` and never fall. */
template <class I> NOT_INLINE bool ascending(const I *at, Size count, Size stride, Size end)
{
    bool good = count > 0 && at[0] == 0 && at[(count - 1) * stride] == end;
    for (Size i = 1; i < count; i++)
        good &= at[i * stride] >= at[(i - 1) * stride];
    return good;
}

/* ---- objects of types of this module ------------------------------------------------------- */

/* Holds a V, made of `V::Arguments`, and these arguments for copies and pickles. */
template <class V> struct Object {
    PyObject_HEAD PyObject *arguments;
    V *value;
    static inline PyTypeObject *type;
};

/* An argument that must be such an object. */
template <class V> class Kept
{
    Ref held;

  public:
    explicit Kept(PyObject *object)
    {
        must(PyObject_TypeCheck(object, Object<V>::type), V::MISSING);
        held = Ref(Py_NewRef(object));
    }
    V *operator->() const { return ((Object<V> *)held.get())->value; }
    V &operator*() const { return *operator->(); }
};

/* What is held for the scalar T. */
template <class T, class R, class C> const auto &held_in(const R &in_real, const C &in_complex)
{
    if constexpr (std::is_same<T, double>::value)
        return in_real;
    else
        return in_complex;
}

/* ---- conversions ---------------------------------------------------------------------------- */

/* Numbers that are used as complex ones, and as real ones where they are. */
struct Numbers {
    Array<Complex, 1> in_complex;
    Maybe<double, 1> in_real;

    explicit Numbers(PyObject *x) : in_complex(x)
    {
        if (!is_complex(x))
            in_real.emplace(x);
    }
};

/* Further arguments, as many as there are. */
template <class A> struct Rest : std::vector<A> {
};

/* An argument that is not looked at. */
struct Ignored {
    explicit Ignored(PyObject *) {}
};

template <class A> struct From {
    static A object(PyObject *x) { return A(x); }
};
template <> struct From<Ref> {
    static Ref object(PyObject *x) { return Ref(Py_NewRef(x)); }
};
template <> struct From<double> {
    static double object(PyObject *x)
    {
        double number = PyFloat_AsDouble(x);
        if (PyErr_Occurred())
            throw Failed();
        return number;
    }
};
template <> struct From<Size> {
    static Size object(PyObject *x)
    {
        Size number = PyNumber_AsSsize_t(x, PyExc_ValueError);
        if (PyErr_Occurred())
            throw Failed();
        must(number >= 0, "a number is negative or too large");
        return number;
    }
};
template <> struct From<int32_t> {
    static int32_t object(PyObject *x)
    {
        Size number = PyNumber_AsSsize_t(x, PyExc_ValueError);
        if (PyErr_Occurred())
            throw Failed();
        must(number >= INT32_MIN && number <= INT32_MAX, "a number is too large");
        return (int32_t)number;
    }
};
template <> struct From<bool> {
    static bool object(PyObject *x)
    {
        int truth = PyObject_IsTrue(x);
        if (truth < 0)
            throw Failed();
        return truth;
    }
};
template <class A> struct From<std::optional<A>> {
    static std::optional<A> object(PyObject *x)
    {
        std::optional<A> given;
        if (x != Py_None)
            given.emplace(From<A>::object(x));
        return given;
    }
};
template <class A> struct From<std::vector<A>> {
    NOT_INLINE static std::vector<A> object(PyObject *x)
    {
        must(PyTuple_Check(x), "several arguments are given as a tuple");
        std::vector<A> all;
        for (Py_ssize_t i = 0; i < PyTuple_Size(x); i++)
            all.push_back(From<A>::object(PyTuple_GetItem(x, i)));
        return all;
    }
};
template <class... A> struct From<std::tuple<A...>> {
    template <size_t... I> static std::tuple<A...> items(PyObject *x, std::index_sequence<I...>)
    {
        return std::tuple<A...>{From<A>::object(PyTuple_GetItem(x, I))...};
    }
    NOT_INLINE static std::tuple<A...> object(PyObject *x)
    {
        must(PyTuple_Check(x) && PyTuple_Size(x) == sizeof...(A),
             "plans and their parts are named tuples of a fixed number of items");
        return items(x, std::index_sequence_for<A...>());
    }
};

PyObject *given(Ref x) { return x.release(); }
PyObject *given(bool x) { return PyBool_FromLong(x); }
PyObject *given(int x) { return PyLong_FromLong(x); }
PyObject *given(Size x) { return PyLong_FromSsize_t(x); }
PyObject *given(double x) { return PyFloat_FromDouble(x); }
template <class T> PyObject *given(Array<T> x) { return x.release(); }
template <class... A> PyObject *given(std::tuple<A...> x)
{
    Ref all = made(PyTuple_New(sizeof...(A)));
    Py_ssize_t at = 0;
    auto set = [&](PyObject *item) {
        if (!item || PyTuple_SetItem(all.get(), at++, item) < 0)
            throw Failed();
    };
    std::apply([&](A &...item) { (set(given(std::move(item))), ...); }, x);
    return all.release();
}

/* ---- functions ------------------------------------------------------------------------------ */

/* Run f; what it throws becomes an error of Python. */
template <class F> auto guarded(F f) -> decltype(f())
{
    try {
        return f();
    } catch (const Failed &) {
    } catch (const std::bad_alloc &) {
        PyErr_NoMemory();
    }
    return nullptr;
}

template <class A> struct Argument {
    static constexpr Py_ssize_t least = 1, most = 1;
    static A at(PyObject *const *args, Py_ssize_t i, Py_ssize_t)
    {
        return From<A>::object(args[i]);
    }
};
template <class A> struct Argument<Rest<A>> {
    static constexpr Py_ssize_t least = 0, most = PY_SSIZE_T_MAX / 64;
    static Rest<A> at(PyObject *const *args, Py_ssize_t i, Py_ssize_t count)
    {
        Rest<A> all;
        for (; i < count; i++)
            all.push_back(From<A>::object(args[i]));
        return all;
    }
};

template <auto f> struct Bound;
template <class R, class... A, R (*f)(A...)> struct Bound<f> {
    template <size_t... I>
    static PyObject *run(PyObject *const *args, Py_ssize_t count, std::index_sequence<I...>)
    {
        /* Arguments are made where f takes them: none is moved. */
        Ref kept(given(f(Argument<std::decay_t<A>>::at(args, I, count)...)));
        if (PyErr_Occurred()) /* in a function that a list calls */
            throw Failed();
        return kept.release();
    }
    static PyObject *call(PyObject *, PyObject *const *args, Py_ssize_t count)
    {
        constexpr Py_ssize_t least = (0 + ... + Argument<std::decay_t<A>>::least);
        constexpr Py_ssize_t most = (0 + ... + Argument<std::decay_t<A>>::most);
        if (count < least || count > most)
            return PyErr_Format(PyExc_ValueError, "takes %zd arguments; got %zd", least, count);
        return guarded([=] { return run(args, count, std::index_sequence_for<A...>()); });
    }
};

/* Whether an argument holds complex numbers, or one of its items, or a plan. */
bool holds_complex(PyObject *const *args, Py_ssize_t count);

/* Calls f, or g where an argument holds complex numbers. */
template <auto f, auto g> struct Either {
    static PyObject *call(PyObject *self, PyObject *const *args, Py_ssize_t count)
    {
        return holds_complex(args, count) ? Bound<g>::call(self, args, count)
                                          : Bound<f>::call(self, args, count);
    }
};

/* Calls f as a method, whose first argument is the object. */
template <auto f> struct OfSelf {
    static PyObject *call(PyObject *self, PyObject *const *args, Py_ssize_t count)
    {
        PyObject *all[16] = {self};
        if (count > 15)
            return PyErr_Format(PyExc_ValueError, "takes at most 15 arguments");
        std::copy(args, args + count, all + 1);
        return Bound<f>::call(self, all, count + 1);
    }
};
