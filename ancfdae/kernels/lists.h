/* Values of a list of operations at many instants, for one scalar type; `load_plan.h` has its codes. */

#define OF_LANES(value)                                                                            \
    for (Size i = 0; i < lanes; i++)                                                               \
        y[i] = value;                                                                              \
    break

/* Numbers stand in rows of `lanes` instants: inputs and constants are given, results follow. */
template <class T> INLINE void list_evaluated_(const Operations *p, Size lanes, T *x)
{
    Size before = p->n_inputs + p->n_constants;
    for (Size k = 0; k < p->n_operations; k++) {
        Size plain = p->op[k] < OPERATIONS; /* else a and b are no numbers */
        const T *a = x + plain * p->a[k] * lanes, *b = x + plain * p->b[k] * lanes;
        T *__restrict y = x + (before + k) * lanes, none;
        switch (p->op[k]) {
        case ADD: OF_LANES(a[i] + b[i]);
        case SUBTRACT: OF_LANES(a[i] - b[i]);
        case MULTIPLY: OF_LANES(a[i] * b[i]);
        case DIVIDE: OF_LANES(a[i] / b[i]);
        case NEGATE: OF_LANES(-a[i]);
        case SQUARE: OF_LANES(a[i] * a[i]);
        case CALL: p->called(p, k, lanes, sizeof(T) / sizeof(double), x); break;
        case RESULT: break;
        default: OF_LANES(operation<T>(p->op[k], a[i], b[i], &none, &none));
        }
    }
}

/* The loops over few lanes are unrolled by the compiler, which knows their number. */
template <class T> void list_evaluated(const Operations *p, Size lanes, T *x)
{
    widely<T>([=]() ALWAYS {
        if (lanes == 1)
            list_evaluated_<T>(p, 1, x);
        else if (lanes == 2)
            list_evaluated_<T>(p, 2, x);
        else
            list_evaluated_<T>(p, lanes, x);
    });
}

/* Outputs, (k, n_outputs), of inputs: number j in row i is from[j][i * step[j]]. Work holds
 * n_numbers times LIST_LANES. */
template <class T>
void list_values(const Operations *p, const T *constants, Size count, const T *const *from,
                 const Size *step, T *work, T *out)
{
    for (Size done = 0; done < count; done += LIST_LANES) {
        Size lanes = count - done < LIST_LANES ? count - done : LIST_LANES;
        T *to = out + done * p->n_outputs;
        for (Size j = 0; j < p->n_inputs; j++)
            for (Size i = 0; i < lanes; i++)
                work[j * lanes + i] = from[j][(done + i) * step[j]];
        for (Size j = 0; j < p->n_constants; j++)
            for (Size i = 0; i < lanes; i++)
                work[(p->n_inputs + j) * lanes + i] = constants[j];
        list_evaluated<T>(p, lanes, work);
        for (Size j = 0; j < p->n_outputs; j++)
            for (Size i = 0; i < lanes; i++)
                to[i * p->n_outputs + j] = work[p->outputs[j] * lanes + i];
    }
}
#undef OF_LANES
