/* The numbers of the package without Python: formulas, matrices, and the loops that run them.
 *
 * Every formula stands once, as a template over its scalar. `kernels.cpp` says what they
 * compute, docs/theory why.
 */

#include <algorithm>
#include <array>
#include <cfloat>
#include <chrono>
#include <climits>
#include <cmath>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <limits>
#include <map>
#include <tuple>
#include <type_traits>
#include <unordered_map>
#include <utility>
#include <vector>

/* Words that headers of Windows take. */
#undef near
#undef far

#if defined(__GNUC__)
#define INLINE inline __attribute__((always_inline))
#define ALWAYS                                                                                     \
    __attribute__((always_inline)) /* Behind the arguments of a function without a name. */
#define NOT_INLINE __attribute__((noinline))
#else
#define INLINE inline
#define ALWAYS
#define NOT_INLINE
#endif
/* Before a short loop that is to become one of vectors; GCC would unroll it first, and then take
 * the loop around it (measured: five times slower). */
#if defined(__GNUC__) && !defined(__clang__)
#define UNROLL_NOT _Pragma("GCC unroll 1")
#else
#define UNROLL_NOT
#endif

namespace
{

using Size = std::ptrdiff_t;
using std::int32_t;
using std::int64_t;
using std::isfinite;
using std::size_t;

/* A pivot this small against the diagonal has no digit left. */
const double ROUND_OFF = 1e-13;
/* The largest element: 8 relative node vectors of 3 numbers. */
enum { MOST_Y = 8, MOST_G = 36, MOST_M = 24, MOST_WIDE = 32 };

#include "scalar.h"

#include "load_plan.h"
#include "constraint_plan.h"

#include "elimination.h"
#include "fronts.h"
#include "checks.h"
#include "sides.h"

#include "bending.h"
#include "elements.h"

#include "blocks.h"
#include "totals.h"

#include "loads.h"
#include "lists.h"
#include "trace.h"

#include "constraint_formulas.h"
#include "constraints.h"
#include "constraint_totals.h"

#include "index_1.h"
#include "explicit.h"
#include "sparse.h"
#include "band.h"
#include "symmetric.h"
#include "orders.h"

#include "control.h"
#include "equations.h"
#include "march.h"
#include "rooms.h"
#include "passes.h"
#include "rest.h"
#include "stages.h"
#include "stage_passes.h"
#include "scene_accelerations.h"

} // namespace
