/* Room for what an iteration writes (`Room` in march.h), in one piece. */

/* A pointer, and how many numbers it wants. */
template <class T> using Wanted = std::pair<T **, Size>;

/* What any system wants; lists of operations want `of_lists` numbers. */
template <class T>
void rooms_of(const Plan<T> &p, Size of_lists, Room<T> *r, T **lists, std::vector<Wanted<T>> *all)
{
    const ConstraintTable *c = p.constraints;
    Size n = p.n_q + p.n_lam, own = p.own ? p.nnz : 0, of_load = 0;
    for (Size k = 0; k < p.n_moving; k++)
        of_load = std::max(of_load, load_work<T>(p.moving[k].plan, p.moving[k].plan->n_U));
    for (T **x : {&r->q_p, &r->dq_p, &r->v_p, &r->q, &r->v, &r->A, &r->a, &r->Q, &r->inner,
                  &r->reaction, &r->ahead, &r->start, &r->force, &r->still})
        all->push_back({x, p.n_q});
    for (T **x : {&r->lam, &r->Phi, &r->rate, &r->defect})
        all->push_back({x, p.n_lam});
    for (Wanted<T> x : {Wanted<T>{&r->U, vectors_room(c, 2)}, {&r->B, c->n_values}, {&r->R, n},
                        {&r->x, n}, {&r->at_end, c->n_c}, {&r->within, 3 * c->n_c}, {&r->mass, own},
                        {&r->turned, own}, {lists, of_lists}, {&r->of_load, of_load}})
        all->push_back(x);
}

/* What matrices want, without room for indices. */
std::vector<Wanted<double>> matrix_rooms(const Plan<double> &p, Room<double> *r)
{
    const Fronts *f = p.fronts;
    Size n = p.n_q + p.n_lam, lower = f ? f->column_at[n] : 0, most = f ? f->most : 0;
    Size matrix = std::max({p.first ? (Size)p.first[n] : 0, p.flat ? n * (3 * p.half + 1) : 0,
                            f ? (Size)f->factor_at[f->count] : 0});
    return {{&r->f_q, p.nnz}, {&r->f_v, p.velocity ? p.nnz : 0}, {&r->sum, p.flat ? p.nnz : 0},
            {&r->matrix, matrix}, {&r->work, 12 * n + 4 * most}, {&r->in_fronts.a, lower},
            {&r->in_fronts.perturbed, lower}, {&r->in_fronts.scale, f ? n : 0},
            {&r->in_fronts.room, 5 * most}, {&r->in_fronts.stack, f ? f->stack : 0},
            {&r->least, n}, {&r->time_factors, p.n_factors}, {&r->columns, 4 * n}};
}

/* Point to parts of the memory, one behind the other, and return what is left of it. */
template <class T>
T *room_given(const std::vector<Wanted<T>> &all, Size left, std::vector<T> *memory)
{
    Size total = left;
    for (auto &[pointer, size] : all)
        total += size;
    memory->resize((size_t)total);
    T *at = memory->data();
    for (auto &[pointer, size] : all)
        *pointer = at, at += size;
    return at;
}
