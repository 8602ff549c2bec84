"""Radau IIA under error control in dense matrices, by the formulas of docs/theory/14-radau.md.

Newton's method, the completion of stages, the embedded formula and the loop over steps are written
here a second time, with complex steps in place of tangents where that is possible.
"""

import numpy as np

from ancfdae.equations import Linearisation
from ancfdae.integrators.prescribed_motion import turn_error
from ancfdae.integrators.problem import InitialValueProblem, vector_sizes
from ancfdae.integrators.radau.stages import EMBEDDED, GAMMA, INVERSE, PLACES
from ancfdae.integrators.recorder import SolutionRecorder
from ancfdae.integrators.step_control.contracts import march
from tests.support.one_by_one import OneByOne

EPS = float(np.finfo(float).eps)
C = PLACES[:, 0]


def dense(pattern, values):
    return pattern.csr(values).toarray()


class DenseRadau(OneByOne):
    order, bears_jumps, many, remedy = 4, True, 10**6, ""

    def __init__(self, system, t_end, rtol, recorder):
        self.system, self.recorder, self.t_end, self.rtol = system, recorder, t_end, rtol
        self.problem = InitialValueProblem.of(system, t_end)
        self.share = 0.05 * rtol ** (4 / 5)
        self.tried = 0

    def consistent(self):
        return *self.problem.initial, ()

    def start(self, h):
        return tuple(np.asarray(x)[None] for x in self.problem.initial)

    def resized(self, state, ratio):
        return state

    def recorded(self, state):
        return *(x[1:] for x in state), ()

    def local(self, t, q, v, a, lam):
        """Return dense M, f_q, f_v and Phi_q at a state."""
        found = self.system.linearise(np.array([t]), q[None], v[None], a[None], lam[None])
        assert isinstance(found, Linearisation)
        M, f_q, f_v = (
            np.zeros((len(q), len(q))) if x is None else dense(self.system.pattern, x[0])
            for x in (found.M, found.f_q, found.f_v)
        )
        return M, f_q, f_v, dense(self.system.constraint_pattern, found.Phi_q[0])

    def saddle(self, K, B):
        return np.block([[K, B.T], [B, np.zeros((len(B), len(B)))]])

    def advance(self, h, before, t):
        """Solve the stages by Newton's method from accelerations that stay."""
        self.tried += 1
        s, (t_0, q_0, v_0, a_0, lam_0) = self.system, (x[-1] for x in before)
        n, m = s.n_q, s.n_lam
        x, lam = np.multiply.outer(C**2 / 2, a_0), np.tile(lam_0, (3, 1))
        times = np.append(t_0 + h * C[:2], t)
        for _ in range(40):
            q, v, a = (
                q_0 + h * PLACES * v_0 + h**2 * x,
                v_0 + h * INVERSE @ x,
                INVERSE @ INVERSE @ x,
            )
            K, B, R = np.zeros((3 * n, 3 * n)), np.zeros((3 * m, 3 * n)), np.zeros(3 * (n + m))
            for i, now in enumerate(times):
                M, f_q, f_v, Phi_q = self.local(now, q[i], v[i], a[i], lam[i])
                its, rows = slice(n * i, n * (i + 1)), slice(m * i, m * (i + 1))
                for j in range(3):
                    to = slice(n * j, n * (j + 1))
                    K[its, to] = (INVERSE @ INVERSE)[i, j] * M + h * INVERSE[i, j] * f_v
                K[its, its] += h**2 * f_q
                B[rows, its] = Phi_q
                R[its] = M @ a[i] + Phi_q.T @ lam[i] - s.force(now, q[i], v[i])
                R[3 * n + m * i : 3 * n + m * (i + 1)] = s.constraint(now, q[i]) / h**2
            change = np.linalg.solve(self.saddle(K, B), R)
            x = x - change[: 3 * n].reshape(3, n)
            lam = lam - change[3 * n :].reshape(3, m)
            if np.linalg.norm(change[: 3 * n]) <= 1e-12 * np.linalg.norm(x):
                break
        self.x = x
        q, V = q_0 + h * PLACES * v_0 + h**2 * x, v_0 + h * INVERSE @ x
        rows = [before_row[-1:] for before_row in before]
        for i, now in enumerate(times):
            M, _, _, Phi_q = self.local(now, q[i], V[i], 0 * V[i], 0 * lam[i])
            K, none = self.saddle(M, Phi_q), np.zeros(n)
            moved = np.linalg.solve(K, np.append(none, -s.constraint(now, q[i], V[i])))
            v = V[i] + moved[:n]
            side = np.append(s.force(now, q[i], v), -s.constraint(now, q[i], v, none))
            a, mult = np.split(np.linalg.solve(K, side), [n])
            new = np.array(now), q[i], v, a, mult
            rows = [np.concatenate([old, y[None]]) for old, y in zip(rows, new, strict=True)]
        return tuple(rows)

    def defects(self, h, middle, v, a, x):
        """Return dq and dv of the embedded formula.

        `middle` is the state (t, q, v, a, lam) of the second stage, v are velocities at the start
        and the stages, a is the acceleration at the start, and x are the displacements.
        """
        M, f_q, f_v, Phi_q = self.local(*middle)
        K = self.saddle(GAMMA**2 * M + GAMMA * h * f_v + h**2 * f_q, Phi_q)
        n, m, e = self.system.n_q, len(Phi_q), EMBEDDED[0]
        dq, dv = h * e @ x, a + e @ INVERSE @ x
        known = dq, a + e @ (v[1:] - v[0]) / h
        for share in (1.0, GAMMA / h):
            r_q, r_v = share * dq, share * dv
            right = h**2 * (M @ (r_v + GAMMA / h * r_q) + f_v @ r_q)
            dq = np.linalg.solve(K, np.append(right, np.zeros(m)))[:n]
            dv = GAMMA / h * dq - r_q
        none = np.zeros(n)
        lifted = [np.linalg.solve(K, np.append(none, h / GAMMA * Phi_q @ y))[:n] for y in known]
        return dq + lifted[0], dv + lifted[1]

    def error(self, h, before, after):
        scales, d = self.problem.scales, self.system.vector_size
        errors = [turn_error(self.system, float(after[0][-1]), h, 4)]
        middle = [x[2] for x in after]
        defects = self.defects(h, middle, after[2], before[3][-1], self.x)
        for k, defect in enumerate(defects):
            ends = after[1 + k][[0, -1]] - (scales.place if k == 0 else 0.0)
            size = vector_sizes(ends, d).max(axis=0) + (scales.q, scales.v)[k]
            blur = EPS * (np.abs(after[1][-1]) + scales.q) / h**k
            errors.append(np.sqrt(np.mean((defect / (self.share * size + blur)) ** 2)))
        return float(np.max(errors))

    def start_error(self):
        h = 0.05 * self.t_end
        return self.error(h, self.start(h), self.advance(h, self.start(h), h)) / h**4


def dense_run(system, t_end, steps):
    """Return a run of `DenseRadau` under `AdaptiveSteps`."""
    recorder = SolutionRecorder(system, 1000, 3)
    method = DenseRadau(system, t_end, steps.rtol, recorder)
    return march(method, steps.controller(t_end, method), recorder, t_end, False)[0]
