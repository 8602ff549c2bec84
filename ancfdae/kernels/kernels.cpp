/* Inner loops of the package: element forces and tangents, sparse products, banded solutions.
 *
 * `core.h` computes, `*_calls.h` check what Python gives, and `binding.h` converts it.
 */

#define PY_SSIZE_T_CLEAN
/* The stable ABI: one build serves every Python from 3.11 on. */
#define Py_LIMITED_API 0x030A0000
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define NPY_TARGET_VERSION NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>

#include <algorithm>
#include <array>
#include <initializer_list>
#include <limits>
#include <memory>
#include <new>
#include <optional>
#include <tuple>
#include <utility>
#include <variant>
#include <vector>

#include "core.h"

namespace
{

#include "binding.h"

#include "element_calls.h"
#include "list_calls.h"
#include "plan_calls.h"
#include "matrix_calls.h"
#include "model_calls.h"

bool holds_complex(PyObject *const *args, Py_ssize_t count)
{
    for (Py_ssize_t i = 0; i < count; i++)
        if (PyTuple_Check(args[i])) {
            for (Py_ssize_t k = 0; k < PyTuple_Size(args[i]); k++) {
                PyObject *item = PyTuple_GetItem(args[i], k);
                if (holds_complex(&item, 1))
                    return true;
            }
        } else if (is_complex(args[i]) ||
                   (PyObject_TypeCheck(args[i], Object<ConstraintPlan>::type) &&
                    Kept<ConstraintPlan>(args[i])->complex_) ||
                   (PyObject_TypeCheck(args[i], Object<LoadPlan>::type) &&
                    Kept<LoadPlan>(args[i])->complex_))
            return true;
    return false;
}

/* ---- types ---------------------------------------------------------------------------------- */

template <class V> PyObject *new_object(PyTypeObject *type, PyObject *arguments, PyObject *names)
{
    return guarded([=]() -> PyObject * {
        must(!names || PyDict_Size(names) == 0, "a plan takes no names");
        auto value = std::make_unique<V>(From<typename V::Arguments>::object(arguments));
        auto *self = (Object<V> *)made(PyType_GenericAlloc(type, 0)).release();
        self->arguments = Py_NewRef(arguments);
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

template <class B> PyMethodDef method(const char *name)
{
    return {name, (PyCFunction)(void (*)(void))B::call, METH_FASTCALL, nullptr};
}

/* Add a type of objects that hold a V, with methods. */
template <class V, auto... f>
bool type_added(PyObject *module, const std::array<const char *, sizeof...(f)> &names)
{
    static std::vector<PyMethodDef> methods;
    size_t at = 0;
    (methods.push_back(method<OfSelf<f>>(names[at++])), ...);
    methods.push_back({"__reduce__", reduced_object<V>, METH_NOARGS, nullptr});
    methods.push_back({nullptr, nullptr, 0, nullptr});
    static PyType_Slot slots[] = {{Py_tp_dealloc, (void *)delete_object<V>},
                                  {Py_tp_methods, methods.data()},
                                  {Py_tp_new, (void *)new_object<V>},
                                  {0, nullptr}};
    static PyType_Spec spec = {V::NAME, sizeof(Object<V>), 0, Py_TPFLAGS_DEFAULT, slots};
    Object<V>::type = (PyTypeObject *)PyType_FromSpec(&spec);
    return Object<V>::type && PyModule_AddType(module, Object<V>::type) == 0;
}

/* ---- module --------------------------------------------------------------------------------- */

/* A matrix of real or complex numbers with right sides of real or complex numbers. */
template <auto real, auto mixed, auto complex_> struct Solver {
    static PyObject *call(PyObject *self, PyObject *const *args, Py_ssize_t count)
    {
        return count > 0 && holds_complex(args, 1) ? Bound<complex_>::call(self, args, count)
                                                   : Either<real, mixed>::call(self, args, count);
    }
};

#define PLAIN(name) method<Bound<&py_##name>>(#name)
#define OF_SCALARS(name) method<Either<&py_##name<double>, &py_##name<Complex>>>(#name)
#define SOLVER(name)                                                                               \
    method<Solver<&py_##name<double, double>, &py_##name<double, Complex>,                         \
                  &py_##name<Complex, Complex>>>(#name)
PyMethodDef methods[] = {
    OF_SCALARS(relative),
    OF_SCALARS(lifted),
    OF_SCALARS(forces),
    OF_SCALARS(forces_along),
    OF_SCALARS(force_totals),
    OF_SCALARS(force_partials),
    OF_SCALARS(tangents),
    OF_SCALARS(strain),
    OF_SCALARS(stressed),
    OF_SCALARS(constraints),
    OF_SCALARS(constraint_curvature),
    OF_SCALARS(constraint_gradient),
    PLAIN(constraint_totals),
    OF_SCALARS(load_forces),
    OF_SCALARS(load_forces_along),
    OF_SCALARS(load_tangents),
    OF_SCALARS(list_values),
    PLAIN(index_1),
    PLAIN(explicit_march),
    PLAIN(explicit_terms),
    PLAIN(plan_step),
    PLAIN(judge_step),
    PLAIN(norm),
    PLAIN(finite),
    OF_SCALARS(csr_rows),
    PLAIN(narrow_order),
    OF_SCALARS(band_factor),
    SOLVER(band_solve),
    OF_SCALARS(ldl_factor),
    SOLVER(ldl_solve),
    PLAIN(eliminate),
    PLAIN(fronts_factor),
    PLAIN(fronts_signs),
    PLAIN(keeps_sides),
    OF_SCALARS(fronts_solve),
    {nullptr, nullptr, 0, nullptr},
};

PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_kernels", nullptr, -1, methods, nullptr, nullptr, nullptr, nullptr};

} // namespace

PyMODINIT_FUNC PyInit__kernels(void)
{
    import_array();
    PyObject *module = PyModule_Create(&definition);
    if (module &&
        !(type_added<ConstraintPlan>(module, {}) && type_added<LoadPlan>(module, {}) &&
          type_added<OperationList>(module, {}) &&
          type_added<OperationTrace, &py_trace_constant, &py_trace_value, &py_trace_apply,
                     &py_trace_power, &py_trace_call, &py_trace_along, &py_trace_partials,
                     &py_trace_rows, &py_trace_inputs, &py_trace_placed, &py_trace_sizes>(
              module, {"constant", "value", "apply", "power", "call", "along", "partials", "rows",
                       "inputs", "placed", "sizes"}) &&
          type_added<Model, &py_march<double, Model>, &py_march_controlled<double, Model>,
                     &py_rest<double, Model>,
                     &py_solve_stages<double, Model>, &py_differentiate_steps,
                     &py_pull_back_steps, &py_find_stages, &py_differentiate_stages,
                     &py_pull_back_stages>(
              module, {"march", "march_controlled", "rest", "solve_stages", "differentiate_steps", "pull_back_steps",
                       "find_stages", "differentiate_stages", "pull_back_stages"}) &&
          type_added<ComplexModel, &py_march<Complex, ComplexModel>,
                     &py_march_controlled<Complex, ComplexModel>,
                     &py_rest<Complex, ComplexModel>, &py_solve_stages<Complex, ComplexModel>>(
              module, {"march", "march_controlled", "rest", "solve_stages"})))
        Py_CLEAR(module);
    return module;
}
