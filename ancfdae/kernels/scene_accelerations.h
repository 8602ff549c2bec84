/* Accelerations of a scene and their design derivatives, by the formulas of `Index1` (index_1.h).
 *
 * With M a + Phi_q^T lam = Q and d^2 Phi/dt^2 = 0, a prime for a total design derivative and a star for
 * one with a and lam held,
 *
 *     M a' + Phi_q^T lam' = Q' - M' a - (Phi_q^T lam)*,     Phi_q a' = -(d^2 Phi/dt^2)*.
 */

/* Factors of time at k instants: of joints with two derivatives, (3, k, n_parts), and of loads, (k,
 * n_factors); and their partials, (n_b, 3, k, n_parts) and (n_b, k, n_factors), or nullptr. */
struct FactorTable {
    Size k;
    const double *joints, *loads, *joints_b, *loads_b;
};

/* Laws of time of a scene. */
struct SceneLaws {
    virtual ~SceneLaws() = default;
    /* Whether they are known: else an error of Python is set. */
    virtual bool at(Size k, const double *t, FactorTable *to) = 0;
};

/* A load that a design variable moves by an imaginary step. */
struct MovedLoad {
    const LoadTable *plan;
    LoadNumbers<Complex> numbers;
};

/* What n_b design variables change: laws of elements, rows of M, (n_b n, n), gravity with steady loads,
 * (n_b, n), rows of loads, (n_b n, n_loads), constraints, and all moving loads, (n_b, n_moving). */
struct SceneDesign {
    Size n_b;
    LawPartials<double> elements;
    Csr<double> mass, loads;
    const double *forces;
    ConstraintPartials constraints;
    std::vector<MovedLoad> moving;
};

struct SceneFormulas : Index1 {
    enum { ORDERS_USED = 3 };
    const Plan<double> *p;
    Room<double> *room;
    SceneDesign design = {};
    SceneLaws *laws = nullptr; /* nullptr where factors do not change with time. */
    FactorTable table = {};
    std::vector<double> times;
    Size instant = -1; /* whose factors stand in `joints` and so on */
    /* Whether Phi_q never changes, whether its matrix is factorised, and whether the design changes
     * constraints at held coordinates. */
    bool linear, constant, known = false, varied = false;
    const double *c[ORDERS_USED];
    double *joints, *joints_b, *loads, *loads_b, *numbers, *U, *zero, *elastic, *total, *given;
    Complex *work, *of_load, *q_c, *v_c, *Q_c, *factors_c;
    std::vector<double> memory;
    std::vector<Complex> wide;

    SceneFormulas(const Plan<double> *of, Room<double> *its, SceneDesign changed)
        : p(of), room(its), design(std::move(changed))
    {
        const ConstraintTable *t = p->constraints;
        n = p->n_q, m = p->n_lam, rows = 1 + design.n_b;
        linear = t->n_s + t->n_formulas == 0, constant = linear && p->still;
        Size n_b = design.n_b, parts = ORDERS_USED * t->n_parts, load = 0;
        varied = n_b && design.constraints.variable[n_b] > 0;
        design.constraints.orders = ORDERS_USED;
        for (const MovedLoad &each : design.moving)
            load = std::max(load, load_work<Complex>(each.plan, 0));
        room_given<double>({{&joints, parts}, {&joints_b, n_b * parts}, {&loads, p->n_factors},
                            {&loads_b, n_b * p->n_factors}, {&numbers, ORDERS_USED * t->n_c},
                            {&U, vectors_room(t, ORDERS_USED - 1)}, {&zero, n},
                            {&elastic, rows * n}, {&total, n_b * std::max(n, m)},
                            {&given, index_1_room()}, {&right, index_1_room()}},
                           0, &memory);
        room_given<Complex>({{&work, n_b ? totals_work(t, ORDERS_USED - 1) : 0}, {&of_load, load},
                             {&q_c, n}, {&v_c, n}, {&Q_c, n}, {&factors_c, p->n_factors}},
                            0, &wide);
    }

    void expect(Size k, const double *t) override
    {
        if (!laws)
            return;
        times.assign(t, t + k), instant = -1;
        if (!laws->at(k, t, &table))
            times.clear();
    }

    /* Factors and coefficients at a time: whether laws know it. */
    bool at(double t)
    {
        if (laws && std::find(times.begin(), times.end(), t) == times.end())
            expect(1, &t);
        auto found = std::find(times.begin(), times.end(), t);
        if (laws && found == times.end())
            return false;
        Size k = laws ? found - times.begin() : 0, parts = p->constraints->n_parts;
        if (k == instant)
            return true;
        instant = k;
        auto taken = [&](Size rows_of, Size width, const double *from, double *to) {
            for (Size i = 0; from && i < rows_of; i++)
                memcpy(to + i * width, from + (i * table.k + k) * width,
                       (size_t)width * sizeof *to);
        };
        taken(ORDERS_USED, parts, table.joints, joints);
        taken(ORDERS_USED * design.n_b, parts, table.joints_b, joints_b);
        taken(1, p->n_factors, table.loads, loads);
        taken(design.n_b, p->n_factors, table.loads_b, loads_b);
        design.constraints.factors_b = table.joints_b ? joints_b : nullptr;
        coefficients<double>(p->constraints, &p->numbers, ORDERS_USED - 1, 0, 1, joints, numbers,
                             c);
        return true;
    }

    int factored(double t, const double *state) override
    {
        if (!at(t))
            return NOT_FINITE;
        if (constant && known)
            return SOLVED;
        factorisations++;
        jacobian_at<double>(p, room, c, state);
        known = !mass_factorised(p, room);
        return known ? SOLVED : SINGULAR;
    }

    int solve(Size count, double *x) override
    {
        memcpy(given, x, (size_t)(count * (n + m)) * sizeof *x);
        return mass_solved(p, room, 'N', count, given, x) ? SINGULAR : SOLVED;
    }

    /* Elastic forces, here with their derivatives, and other forces; -d^2 Phi/dt^2 at a = 0. */
    void sides(double, const double *state, double *x) override
    {
        const double *q = state, *v = state + rows * n, *X[] = {q, v, zero};
        const double *damping = p->damped ? v : nullptr;
        Block<double> block = p->block;
        block.k = rows;
        memset(elastic, 0, (size_t)(rows * n) * sizeof *elastic);
        if (rows > 1)
            force_totals<double>(p->n_y, p->d, &block, &design.elements, q, damping, elastic);
        else
            forces<double>(p->n_y, p->d, &block, q, damping, elastic);
        applied_at<double>(p, room, loads, q, v, elastic);
        memcpy(x, room->Q, (size_t)n * sizeof *x);
        memset(x + n, 0, (size_t)m * sizeof *x);
        if (!constant)
            constraints<double>(p->constraints, p->numbers.l, RATE, 2, c, X, nullptr, U, x + n);
        for (Size i = n; i < n + m; i++)
            x[i] = -x[i];
    }

    /* Total derivatives of Phi of an order, or of Phi_q^T lam, to rows of `total`; with the motion
     * held where they do not depend on it. The last rate of a motion (q, v, a) is held. */
    void totals(int what, int order, bool held, const double *const *X, const double *state,
                const double *lam)
    {
        Size size = what == RATE ? m : n;
        TotalStates s = {what, order, 1, joints, {}, {}, lam, nullptr};
        for (int k = 0; k <= order; k++) {
            s.X[k] = X[k];
            s.X_b[k] = held || k > 1 ? nullptr : state + (k * rows + 1) * n;
        }
        memset(total, 0, (size_t)(design.n_b * size) * sizeof *total);
        if (!held || varied)
            constraint_totals(p->constraints, &p->numbers, &design.constraints, &s, work, total);
    }

    /* Add derivatives of the forces of moving loads to `total`. */
    void add_moving(const double *state)
    {
        Size n_factors = p->n_factors;
        for (Size i = 0; p->n_moving && i < design.n_b; i++) {
            for (Size j = 0; j < n; j++) {
                q_c[j] = Complex(state[j], IMAGINARY_STEP * state[(1 + i) * n + j]);
                v_c[j] = Complex(state[rows * n + j], IMAGINARY_STEP * state[(rows + 1 + i) * n + j]);
                Q_c[j] = 0;
            }
            for (Size j = 0; j < n_factors; j++)
                factors_c[j] = Complex(
                    loads[j], table.loads_b ? IMAGINARY_STEP * loads_b[i * n_factors + j] : 0);
            for (Size k = 0; k < p->n_moving; k++) {
                const MovedLoad &its = design.moving[(size_t)(i * p->n_moving + k)];
                load_force<Complex>(its.plan, &its.numbers, factors_c + p->moving[k].factor, q_c,
                                    v_c, of_load, Q_c);
            }
            for (Size j = 0; j < n; j++)
                total[i * n + j] += imaginary_part(Q_c[j]) / IMAGINARY_STEP;
        }
    }

    void changes(double, const double *state, const double *x, double *out) override
    {
        Size n_b = design.n_b, size = n + m;
        const double *X[] = {state, state + rows * n, x};
        for (Size i = 0; i < n_b * n; i++)
            total[i] = design.forces[i] - elastic[n + i];
        csr_alone<double>(n_b * n, design.mass.first, design.mass.columns, design.mass.values, x, -1,
                          total);
        csr_alone<double>(n_b * n, design.loads.first, design.loads.columns, design.loads.values,
                          loads, 1, total);
        for (Size i = 0; table.loads_b && i < n_b; i++)
            for (Size k = 0; k < p->n_loads; k++)
                for (Size j = 0; j < n; j++)
                    total[i * n + j] += loads_b[i * p->n_factors + k] * p->loads[k * n + j];
        add_moving(state);
        for (Size i = 0; i < n_b; i++)
            memcpy(out + i * size, total + i * n, (size_t)n * sizeof *out);
        totals(FORCE, 0, linear, X, state, x + n);
        for (Size i = 0; i < n_b; i++)
            for (Size j = 0; j < n; j++)
                out[i * size + j] -= total[i * n + j];
        totals(RATE, 2, constant, X, state, nullptr);
        for (Size i = 0; i < n_b; i++)
            for (Size j = 0; j < m; j++)
                out[i * size + n + j] = -total[i * m + j];
    }

    void defects(bool speed, bool derivatives, double, const double *state, double *out) override
    {
        Size size = n + m, n_b = design.n_b;
        const double *q = state, *v = state + rows * n, *X[] = {q, v};
        if (!derivatives)
            return constraint_at<double>(p, room, speed, c, q, v, out);
        if (constant && !varied)
            return csr_rows<double>(m, p->B.first, p->B.columns, room->B, n_b, n,
                                    (speed ? v : q) + n, room->work, 1, size, out);
        totals(RATE, speed, false, X, state, nullptr);
        for (Size i = 0; i < n_b; i++)
            memcpy(out + i * size, total + i * m, (size_t)m * sizeof *out);
    }
};
