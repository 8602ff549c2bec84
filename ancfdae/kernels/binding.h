/* How arguments from Python become those of functions in C++, once for all functions.
 *
 * `Bound<f>::call` converts each argument by its type, calls f and converts what it returns.
 * Arrays are taken in one piece and converted to their type, as NumPy does safely; what does not
 * fit raises ValueError or TypeError. `Either<f, g>` calls g where an argument is complex. The
 * types of f are also what the stub says of it (`told`), so that a function is declared once.
 */

/* Python's error is set. */
struct Failed {
};

void must(bool good, const char *what)
{
    if (good)
        return;
    PyErr_SetString(PyExc_ValueError, what);
    throw Failed();
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

/* What f returns; meanwhile other threads may run Python, if it takes long. */
template <class F> auto unlocked(F f, bool much = true)
{
    struct Others {
        PyThreadState *kept;
        ~Others()
        {
            if (kept)
                PyEval_RestoreThread(kept);
        }
    } others{much ? PyEval_SaveThread() : nullptr};
    return f();
}

/* While this lives, Python may be run. */
class Locked
{
    PyGILState_STATE state = PyGILState_Ensure();

  public:
    ~Locked() { PyGILState_Release(state); }
};

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

/* A length that is asked for: one below zero is any, and a pointer takes what there is. */
struct Length {
    Size least;
    Size *found = nullptr;
    Length(Size n) : least(n) {}
    Length(Size *to) : least(-1), found(to) {}
};

/* An array in one piece; the axes are counted from the first, negative ones from the last. */
class Shaped
{
  protected:
    Ref held;
    void *numbers() const { return PyArray_DATA((PyArrayObject *)held.get()); }

  public:
    int axes;
    Size size;
    const npy_intp *shape;

    /* Of a type of NumPy, converted, or as it is, to write to. */
    NOT_INLINE Shaped(PyObject *object, int type, int least, bool in_place = false)
    {
        auto *own = (PyArrayObject *)object;
        must(object != Py_None, "an array is missing");
        must(!in_place ||
                 (PyArray_Check(object) && PyArray_TYPE(own) == type && PyArray_ISCARRAY(own)),
             "an array to write to has another type or shape, or is not in one piece");
        held = in_place ? Ref(Py_NewRef(object))
                        : made(PyArray_FROM_OTF(object, type, NPY_ARRAY_IN_ARRAY));
        own = (PyArrayObject *)held.get();
        axes = PyArray_NDIM(own), shape = PyArray_DIMS(own), size = PyArray_SIZE(own);
        must(axes >= least, "an array has too few axes");
    }
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
    /* Whether the last axes have these lengths. */
    NOT_INLINE bool ends(std::initializer_list<Length> lengths) const
    {
        int axis = axes - (int)lengths.size();
        if (axis < 0)
            return false;
        for (const Length &each : lengths) {
            Size length = shape[axis++];
            if (length != each.least && each.least >= 0)
                return false;
            if (each.found)
                *each.found = length;
        }
        return true;
    }
    bool has(std::initializer_list<Length> lengths) const
    {
        return axes == (int)lengths.size() && ends(lengths);
    }
    bool alike(const Shaped &other) const
    {
        return axes == other.axes && std::equal(shape, shape + axes, other.shape);
    }
};

/* An array with at least AXES axes. */
template <class T, int AXES = 0> struct Array : Shaped {
    T *data;
    explicit Array(PyObject *object, bool in_place = false)
        : Shaped(object, TYPE<T>, AXES, in_place), data((T *)numbers())
    {
    }
    explicit Array(const Ref &object) : Array(object.get()) {}
};

/* An array of this type that is written to where it stands. */
template <class T> struct InPlace : Array<T> {
    explicit InPlace(PyObject *object) : Array<T>(object, true) {}
};

template <class T, int AXES = 0> using Maybe = std::optional<Array<T, AXES>>;
using Indices = Array<int32_t, 1>;
using Longs = Array<int64_t, 1>;

template <class A> auto data_of(const std::optional<A> &x) { return x ? x->data : nullptr; }

/* Numbers that are real or complex; real ones become complex once they are asked for. */
struct Numbers : Shaped {
    bool in_complex;
    mutable Maybe<Complex> wide;

    explicit Numbers(PyObject *x, int least = 0)
        : Shaped(x, is_complex(x) ? NPY_CDOUBLE : NPY_DOUBLE, least), in_complex(is_complex(x))
    {
    }
    /* Real and imaginary parts, and how far real parts are apart. */
    const double *parts() const { return (const double *)numbers(); }
    int stride() const { return in_complex ? 2 : 1; }
    template <class T> const T *in() const
    {
        if (std::is_same<T, double>::value == !in_complex)
            return (const T *)numbers();
        must(!in_complex, "numbers must be real");
        if (!wide)
            wide.emplace(held);
        return (const T *)wide->data;
    }
};

template <class T> NOT_INLINE Array<T> zeros(std::initializer_list<Size> shape)
{
    return Array<T>(
        made(PyArray_ZEROS((int)shape.size(), const_cast<npy_intp *>(shape.begin()), TYPE<T>, 0)));
}

/* Zeros with the axes of an array but its last ones, and then more. */
template <class T>
NOT_INLINE Array<T> zeros_like(const Shaped &model, int last, std::initializer_list<Size> more)
{
    std::vector<npy_intp> shape(model.shape, model.shape + (model.axes - last));
    shape.insert(shape.end(), more);
    return Array<T>(made(PyArray_ZEROS((int)shape.size(), shape.data(), TYPE<T>, 0)));
}

/* An array of a row of numbers. */
template <class T> Array<T> copied(Size n, const T *x)
{
    auto array = zeros<T>({n});
    std::copy(x, x + n, array.data);
    return array;
}

template <class I, int AXES> Span<I> span_of(const Array<I, AXES> &x) { return {x.data, x.size}; }
template <class I, int AXES> bool within(const Array<I, AXES> &x, Size least, Size most)
{
    return within(span_of(x), least, most);
}
template <class I> bool ascending(const Array<I, 1> &x, Size end)
{
    return ascending(span_of(x), end);
}

/* ---- objects of types of this module ------------------------------------------------------- */

/* Holds a V, made of `V::Arguments`, and these arguments for copies and pickles. */
struct Holder {
    PyObject_HEAD PyObject *arguments;
    bool in_complex;
};
template <class V> struct Object : Holder {
    V *value;
    static inline PyTypeObject *type;
};

/* What holds no complex numbers. */
struct OfReals {
    static constexpr bool in_complex = false;
};

/* The types whose objects may hold complex numbers: `V::in_complex` is not constant. */
std::vector<PyTypeObject *> TYPES;

/* An argument that must be such an object. */
template <class V> class Kept
{
    Ref held;

  public:
    explicit Kept(PyObject *object)
    {
        if (!PyObject_TypeCheck(object, Object<V>::type)) {
            PyErr_Format(PyExc_ValueError, "an argument must be of the type %s", V::NAME);
            throw Failed();
        }
        held = Ref(Py_NewRef(object));
    }
    V *operator->() const { return ((Object<V> *)held.get())->value; }
    V &operator*() const { return *operator->(); }
};

/* Whether an argument holds complex numbers, or one of its items, or an object. */
bool holds_complex(PyObject *x)
{
    if (PyTuple_Check(x)) {
        for (Py_ssize_t k = 0; k < PyTuple_Size(x); k++)
            if (holds_complex(PyTuple_GetItem(x, k)))
                return true;
        return false;
    }
    return is_complex(x) ||
           (std::find(TYPES.begin(), TYPES.end(), Py_TYPE(x)) != TYPES.end() &&
            ((Holder *)x)->in_complex);
}

/* ---- conversions ---------------------------------------------------------------------------- */

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
/* A whole number from `least` to `most`. */
template <class I> I whole(PyObject *x, Size least, Size most)
{
    Size number = PyNumber_AsSsize_t(x, PyExc_ValueError);
    if (PyErr_Occurred())
        throw Failed();
    must(number >= least && number <= most, "a number is negative or too large");
    return (I)number;
}
template <> struct From<Size> {
    static Size object(PyObject *x) { return whole<Size>(x, 0, PY_SSIZE_T_MAX); }
};
template <> struct From<int32_t> {
    static int32_t object(PyObject *x) { return whole<int32_t>(x, INT32_MIN, INT32_MAX); }
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
template <> struct From<Numbered> {
    static Numbered object(PyObject *x)
    {
        Indices all(x);
        return Numbered(all.data, all.data + all.size);
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

/* Items of a tuple, taken one after the other. Arrays go to pointers and live as long as this: to
 * const numbers they are converted, others are written to where they stand. */
class Items
{
    Ref tuple;
    Py_ssize_t next = 0;
    std::vector<Ref> kept;
    std::deque<Items> parts;

    PyObject *item() { return PyTuple_GetItem(tuple.get(), next++); }

  public:
    Items(PyObject *x, Py_ssize_t count) : tuple(Py_NewRef(x))
    {
        must(PyTuple_Check(x) && (count < 0 || PyTuple_Size(x) == count),
             "plans and their parts are named tuples of a fixed number of items");
    }
    Py_ssize_t size() const { return PyTuple_Size(tuple.get()); }
    template <class A> A take() { return From<A>::object(item()); }
    template <class T> Items &operator()(T *&to, std::initializer_list<Length> lengths)
    {
        Array<std::remove_const_t<T>> array(item(), !std::is_const<T>::value);
        must(array.has(lengths), "states, tables and rows must have the shapes of a plan");
        to = array.data;
        kept.emplace_back(array.release());
        return *this;
    }
    bool none() const { return PyTuple_GetItem(tuple.get(), next) == Py_None; }
    template <class T> Items &maybe(T *&to, std::initializer_list<Length> lengths)
    {
        return none() ? (to = nullptr, next++, *this) : (*this)(to, lengths);
    }
    /* A structure that is made of numbers. */
    template <class S> Items &numbers(S &to)
    {
        const double *from;
        (*this)(from, {(Size)(sizeof(S) / sizeof(double))});
        memcpy(&to, from, sizeof(S));
        return *this;
    }
    /* The items of an item, and nullptr for None. */
    Items &part(Py_ssize_t count) { return parts.emplace_back(item(), count); }
    Items *maybe_part(Py_ssize_t count) { return none() ? (next++, nullptr) : &part(count); }
};

/* An argument of N items; they are not None. */
template <int N> struct Fields : Items {
    explicit Fields(PyObject *x) : Items(x, N) {}
};

PyObject *given(Ref x) { return x.release(); }
PyObject *given(bool x) { return PyBool_FromLong(x); }
PyObject *given(int x) { return PyLong_FromLong(x); }
PyObject *given(Size x) { return PyLong_FromSsize_t(x); }
PyObject *given(double x) { return PyFloat_FromDouble(x); }
template <class T> PyObject *given(const std::vector<T> &x)
{
    return copied((Size)x.size(), x.data()).release();
}
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

/* What a function of Python returns for these arguments. */
template <class... A> Ref called(const Ref &function, A... arguments)
{
    Ref all(given(std::tuple<A...>(std::move(arguments)...)));
    return made(PyObject_CallObject(function.get(), all.get()));
}

/* ---- what the stub says --------------------------------------------------------------------- */

using Text = std::string;
Text told(double *) { return "float"; }
Text told(bool *) { return "bool"; }
Text told(int *) { return "int"; }
Text told(Size *) { return "int"; }
Text told(Ref *) { return "Any"; }
Text told(Items *) { return "tuple[Any, ...]"; }
Text told(Shaped *) { return "Array"; }
Text told(Numbered *) { return "Array"; }
Text told(std::vector<int64_t> *) { return "Array"; }
template <class V> Text told(Kept<V> *) { return V::NAME; }
template <class A> Text told(Rest<A> *);
template <class A> Text told(std::optional<A> *);
template <class A> Text told(std::vector<A> *);
template <class... A> Text told(std::tuple<A...> *)
{
    Text all;
    ((all += (all.empty() ? "" : ", ") + told((A *)nullptr)), ...);
    return "tuple[" + all + "]";
}
template <class A> Text told(Rest<A> *) { return told((A *)nullptr); }
template <class A> Text told(std::optional<A> *) { return told((A *)nullptr) + " | None"; }
template <class A> Text told(std::vector<A> *) { return "tuple[" + told((A *)nullptr) + ", ...]"; }

/* Names of arguments, separated by commas, with their types; `self` has none. */
template <class... A> Text arguments_told(const Text &names)
{
    std::vector<Text> types = {told((A *)nullptr)...};
    Text all;
    size_t from = 0, at = 0;
    for (const Text &type : types) {
        size_t end = std::min(names.find(", ", from), names.size());
        Text name = names.substr(from, end - from);
        all += name[0] == '*' && at ? "/, " : "";
        all += name == "self" ? "self, " : name + ": " + type + ", ";
        from = std::min(end + 2, names.size()), at += name != "self";
    }
    must(from == names.size(), "a function is declared with other arguments");
    return "(" + all + (at && names.find('*') == Text::npos ? "/" : "") + ")";
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
    static Text told_of(const Text &names)
    {
        return arguments_told<std::decay_t<A>...>(names) + " -> " + told((R *)nullptr);
    }
};

/* Calls f, or g where one of the first `looked` arguments holds complex numbers. */
template <class F, class G, Py_ssize_t looked = PY_SSIZE_T_MAX> struct Either : F {
    static PyObject *call(PyObject *self, PyObject *const *args, Py_ssize_t count)
    {
        bool wide = std::any_of(args, args + std::min(count, looked), holds_complex);
        return (wide ? G::call : F::call)(self, args, count);
    }
};

/* Calls F as a method, whose first argument is the object. */
template <class F> struct OfSelf : F {
    static PyObject *call(PyObject *self, PyObject *const *args, Py_ssize_t count)
    {
        PyObject *all[16] = {self};
        if (count > 15)
            return PyErr_Format(PyExc_ValueError, "takes at most 15 arguments");
        std::copy(args, args + count, all + 1);
        return F::call(self, all, count + 1);
    }
    static Text told_of(const Text &names)
    {
        return F::told_of(names.empty() ? "self" : "self, " + names);
    }
};

/* A text that stays. */
const char *lasting(Text text)
{
    static std::deque<Text> all;
    return all.emplace_back(std::move(text)).c_str();
}

/* A function as the module holds it; its documentation begins as its line in a stub. */
template <class F> PyMethodDef declared(const char *name, const char *names, const char *what)
{
    const char *doc = lasting(name + F::told_of(names) + "\n" + what);
    return {name, (PyCFunction)(void (*)(void))F::call, METH_FASTCALL, doc};
}

template <class V> PyObject *new_object(PyTypeObject *type, PyObject *arguments, PyObject *names)
{
    return guarded([=]() -> PyObject * {
        must(!names || PyDict_Size(names) == 0, "a plan takes no names");
        auto value = std::make_unique<V>(From<typename V::Arguments>::object(arguments));
        auto *self = (Object<V> *)made(PyType_GenericAlloc(type, 0)).release();
        self->arguments = Py_NewRef(arguments);
        self->in_complex = value->in_complex;
        self->value = value.release();
        return (PyObject *)self;
    });
}

template <class V> void delete_object(PyObject *object)
{
    auto *self = (Object<V> *)object;
    PyTypeObject *type = Py_TYPE(object);
    delete self->value;
    Py_XDECREF(self->arguments);
    PyObject_Free(self);
    Py_DECREF(type);
}

template <class V> PyObject *reduced_object(PyObject *self, PyObject *)
{
    return Py_BuildValue("(OO)", Py_TYPE(self), ((Object<V> *)self)->arguments);
}

template <class... A> Text constructor_told(std::tuple<A...> *, const Text &names)
{
    return "__init__" + arguments_told<Ref, A...>("self, " + names) + " -> None";
}

/* Add a type of objects that hold a V, which is made of arguments with these names. */
template <class V>
void type_added(PyObject *module, const char *names, const char *what,
                std::vector<PyMethodDef> of_type)
{
    static std::vector<PyMethodDef> methods = std::move(of_type);
    methods.push_back({"__reduce__", reduced_object<V>, METH_NOARGS,
                       "__reduce__(self) -> tuple[Any, tuple[Any, ...]]\n"});
    methods.push_back({nullptr, nullptr, 0, nullptr});
    const char *doc =
        lasting(constructor_told((typename V::Arguments *)nullptr, names) + "\n" + what);
    static PyType_Slot slots[] = {{Py_tp_dealloc, (void *)delete_object<V>},
                                  {Py_tp_methods, methods.data()},
                                  {Py_tp_new, (void *)new_object<V>},
                                  {Py_tp_doc, (void *)doc},
                                  {0, nullptr}};
    static Text name = Text("ancfdae.kernels._kernels.") + V::NAME;
    static PyType_Spec spec = {name.c_str(), sizeof(Object<V>), 0, Py_TPFLAGS_DEFAULT, slots};
    Object<V>::type = (PyTypeObject *)made(PyType_FromSpec(&spec)).release();
    if (!std::is_const<decltype(V::in_complex)>::value)
        TYPES.push_back(Object<V>::type);
    if (PyModule_AddType(module, Object<V>::type) < 0)
        throw Failed();
}
