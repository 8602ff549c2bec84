/* Equations of a system of one's own, in place of elements, joints and loads. */

/* Values of matrices stand on the patterns of a plan. */
template <class T> struct Equations {
    virtual ~Equations() = default;
    virtual void mass(const T *q, T *M) = 0;
    virtual void jacobian(T t, const T *q, T *B) = 0;
    /* Phi, or its time derivative of an order along v, the second one without accelerations. */
    virtual void constraint(T t, int order, const T *q, const T *v, T *Phi) = 0;
    virtual void force(T t, const T *q, const T *v, T *Q) = 0;
    /* f_q, and f_v where forces use velocities. */
    virtual void tangents(T t, const T *q, const T *v, const T *A, const T *lam, T *f_q,
                          T *f_v) = 0;
    /* Loads in Q that turn with the motion, at rest, and their derivative in q; whether there are
     * any. */
    virtual bool following(T, const T *, T *, T *) { return false; }
};

/* Equations that are lists of operations. All of them take t, q, v, A, lam and b: Phi_q, Phi, dPhi/dt,
 * d^2 Phi/dt^2, Q, M, and f_q with f_v behind it where forces use velocities. */
enum { OF_JACOBIAN, OF_PLACE, OF_RATE, OF_RATE_2, OF_FORCE, OF_MASS, OF_TANGENTS, MARCH_LISTS };

template <class T> struct Listed final : Equations<T> {
    const Operations *of[MARCH_LISTS];
    const T *constants[MARCH_LISTS], *b;
    Size n_q, n_lam, n_b;
    T *numbers; /* Room for the numbers of each list. */

    Size room() const
    {
        Size most = 0;
        for (const Operations *each : of)
            most = each->n_numbers > most ? each->n_numbers : most;
        return most;
    }

    /* Outputs of a list at a state, of which it reads what is given; those behind the first ones go
     * to `more`. */
    void at(int which, T t, const T *q, const T *v, const T *A, const T *lam, T *out,
            T *more = nullptr, Size first = 0)
    {
        const Operations *list = of[which];
        const T *parts[] = {&t, q, v, A, lam, b, constants[which]};
        Size sizes[] = {1, n_q, n_q, n_q, n_lam, n_b, list->n_constants};
        T *to = numbers;
        for (int i = 0; i < 7; to += sizes[i++])
            if (parts[i])
                memcpy(to, parts[i], (size_t)sizes[i] * sizeof(T));
        list_evaluated<T>(list, 1, numbers);
        for (Size i = 0; i < list->n_outputs; i++)
            (more && i >= first ? more[i - first] : out[i]) = numbers[list->outputs[i]];
    }

    void mass(const T *q, T *M) override { at(OF_MASS, 0, q, nullptr, nullptr, nullptr, M); }
    void jacobian(T t, const T *q, T *B) override
    {
        at(OF_JACOBIAN, t, q, nullptr, nullptr, nullptr, B);
    }
    void constraint(T t, int order, const T *q, const T *v, T *Phi) override
    {
        std::fill(numbers + 1 + 2 * n_q, numbers + 1 + 3 * n_q, T(0));
        at(OF_PLACE + order, t, q, v, nullptr, nullptr, Phi);
    }
    void force(T t, const T *q, const T *v, T *Q) override
    {
        at(OF_FORCE, t, q, v, nullptr, nullptr, Q);
    }
    void tangents(T t, const T *q, const T *v, const T *A, const T *lam, T *f_q, T *f_v) override
    {
        at(OF_TANGENTS, t, q, v, A, lam, f_q, f_v, of[OF_MASS]->n_outputs);
    }
};
