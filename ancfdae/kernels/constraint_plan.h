/* Where the numbers of constraints stand; `constraints.h` says what they are. */

/* Orders of time derivatives, and what counts to the begin of a joint: its vectors, linear entries,
 * products, rows, parts and entries that move, and their places. */
enum { ORDERS = 4 };
/* What is asked of constraints: Phi, values of Phi_q, or Phi_q^T lam. */
enum { RATE, VALUES, FORCE };
enum { VECTOR, LINEAR, PRODUCT, ROW, PART, MOVING, PLACE_LINEAR, PLACE_PRODUCT, JOINT_ITEMS };

const double BINOMIAL[ORDERS][ORDERS] = {{1}, {1, 1}, {1, 2, 1}, {1, 3, 3, 1}};

/* `joints` has a row for the begin of every joint and one for the end. Row r of L has the entries
 * first[r] to first[r + 1] - 1. Linear entry e picks component linear_at[e] of U; the vectors of
 * product e begin at components i[e] and j[e]. Products of raw entries of Phi_U with entries of L
 * go to places among n_values values of Phi_q, pairs of entries of L to two places each among
 * n_curved of (Phi_q^T lam)_q. A joint has at most `most` components of vectors. */
struct ConstraintTable {
    Size n_joints, n_q, n_lam, n_parts, n_a, n_s, n_c, n_l, n_moving, n_values, n_curved, most;
    int d;
    const int32_t *joints, *first, *columns, *linear_row, *linear_at, *row, *i, *j;
    const int32_t *place_linear, *place_product, *curved, *moving_at, *moving_part;
};
