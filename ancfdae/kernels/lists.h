/* Values of a list of operations at many instants, for one scalar type; `load_plan.h` has its codes. */

#define OF_LANES(value)                                                                            \
    for (npy_intp i = 0; i < lanes; i++)                                                           \
        y[i] = value;                                                                              \
    break

/* Numbers stand in rows of `lanes` instants: inputs and constants are given, results follow. */
CLONES static void NAME(list_evaluated)(const operation_list *p, npy_intp lanes, T *x)
{
    npy_intp before = p->n_inputs + p->n_constants;
    for (npy_intp k = 0; k < p->n_operations; k++) {
        npy_intp plain = p->op[k] < OPERATIONS; /* else a and b are no numbers */
        const T *a = x + plain * p->a[k] * lanes, *b = x + plain * p->b[k] * lanes;
        T *restrict y = x + (before + k) * lanes, none;
        switch (p->op[k]) {
        case ADD: OF_LANES(a[i] + b[i]);
        case SUBTRACT: OF_LANES(a[i] - b[i]);
        case MULTIPLY: OF_LANES(a[i] * b[i]);
        case DIVIDE: OF_LANES(a[i] / b[i]);
        case NEGATE: OF_LANES(-a[i]);
        case SQUARE: OF_LANES(a[i] * a[i]);
        case CALL:
            list_called(p, k, lanes, sizeof(T) > sizeof(double) ? NPY_CDOUBLE : NPY_DOUBLE, x);
            break;
        case RESULT: break;
        default: OF_LANES(NAME(operation)(p->op[k], a[i], b[i], &none, &none));
        }
    }
}

/* Outputs, (k, n_outputs), of inputs, (k, n_inputs); work holds n_numbers times LIST_LANES. */
static void NAME(list_values)(const operation_list *p, const T *constants, npy_intp count,
                              const T *inputs, T *work, T *out)
{
    for (npy_intp done = 0; done < count; done += LIST_LANES) {
        npy_intp lanes = count - done < LIST_LANES ? count - done : LIST_LANES;
        const T *from = inputs + done * p->n_inputs;
        T *to = out + done * p->n_outputs;
        for (npy_intp j = 0; j < p->n_inputs; j++)
            for (npy_intp i = 0; i < lanes; i++)
                work[j * lanes + i] = from[i * p->n_inputs + j];
        for (npy_intp j = 0; j < p->n_constants; j++)
            for (npy_intp i = 0; i < lanes; i++)
                work[(p->n_inputs + j) * lanes + i] = constants[j];
        NAME(list_evaluated)(p, lanes, work);
        for (npy_intp j = 0; j < p->n_outputs; j++)
            for (npy_intp i = 0; i < lanes; i++)
                to[i * p->n_outputs + j] = work[p->outputs[j] * lanes + i];
    }
}
#undef OF_LANES
