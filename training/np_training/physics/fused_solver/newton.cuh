// The body of the function `newton` of kernel.py: Newton's method for the constraints of one world, by one warp.
//
// MuJoCo's constrained acceleration a minimises the convex cost (documentation of MuJoCo, "Computation", "Primal problem")
//
//     cost(a) = 1/2 (a - a0)' M (a - a0) + sum over rows s(x),   x = J a - aref,   M a0 = smooth,
//     gradient = M a - smooth - J' f,   f = -ds/dx,
//     Hessian  = M + J' C J,            C = d2s/dx2, diagonal but for 3 x 3 blocks of sliding contacts.
//
// An iteration: forces and C, gradient, Cholesky factor of the Hessian, search direction, exact line search.
//
// Units of a: m/s^2, rad/s^2; of f: N, Nm. NV degrees of freedom, ROWS rows at most, `rows` rows of this world.
// `lane` is 0..31 of the warp on CUDA; on the CPU one lane does all. Lane l takes the elements l, l + LANES, ...
// A world leaves as soon as it has converged: no world waits for another.

#if defined(__CUDA_ARCH__)
#define NEWTON_SHARED __shared__
    const int LANES = 32;
    auto wait = [] { __syncwarp(); };
    auto sum_lanes = [](float value) {
        for (int other = 16; other > 0; other /= 2) value += __shfl_xor_sync(0xffffffffu, value, other);
        return __shfl_sync(0xffffffffu, value, 0);  // the same bits everywhere: all lanes take the same branches
    };
#else
#define NEWTON_SHARED
    const int LANES = 1;
    auto wait = [] {};
    auto sum_lanes = [](float value) { return value; };
#endif

    // --- Shared memory: (18 + NV) ROWS + 2 NV (NV + 8) words about, 7 KiB with 44 rows ----------------------------------------
    // Matrices have an odd width, so that lanes that read one column of neighbouring rows use different banks.
    const int WIDTH = NV | 1;
    const int PAIRS = NV * (NV + 1) / 2;              // entries of a lower triangle
    const int PAIRS_A_LANE = (PAIRS + LANES - 1) / LANES;
    NEWTON_SHARED float J[ROWS * WIDTH];              // Jacobian, row by row
    NEWTON_SHARED float x[ROWS];                      // J a - aref
    NEWTON_SHARED float slope[ROWS];                  // dx by a unit of the step: J search
    NEWTON_SHARED float D[ROWS];                      // stiffness of the row, 1 / regularisation
    NEWTON_SHARED float bound[ROWS];                  // friction loss; mu of a normal row; coefficient of a tangential row
    NEWTON_SHARED float force[ROWS];                  // f
    NEWTON_SHARED float block[ROWS * 3];              // C of a sliding contact at its normal row: nn, nt, nu, tt, tu, uu
    NEWTON_SHARED unsigned char kind[ROWS];           // what the row is: enum Kind
    NEWTON_SHARED unsigned char state[ROWS];          // where on its cost the row is: mujoco_warp's ConstraintState
    NEWTON_SHARED float M[NV * WIDTH];                // inertia, both triangles
    NEWTON_SHARED float L[(NV + 1) * WIDTH];          // Hessian, then its factor, lower triangle; below it the gradient
    NEWTON_SHARED float a[NV], Ma[NV];                // acceleration, M a
    NEWTON_SHARED float smooth[NV];                   // force without constraints
    NEWTON_SHARED float pull[NV];                     // J' f
    NEWTON_SHARED float search[NV], Msearch[NV];      // direction of the step, M search
    float* y = L + NV * WIDTH;                        // the row below: gradient, L^-1 gradient, then the solution

    enum Kind { EQUALITY, FRICTION, ONE_SIDED, NORMAL, TANGENT, DROPPED };
    enum State { SATISFIED, QUADRATIC, LINEAR_NEGATIVE, LINEAR_POSITIVE, CONE };
    const float TINY = 1e-15f;

    // --- Parts -----------------------------------------------------------------------------------------------------------------

    // Contact at its normal row r, at x and along `slope`: the cone in coordinates n = mu x_n, t = |(mu_1 x_1, mu_2 x_2)|.
    // Zones: n >= mu t satisfied; mu n + t <= 0 quadratic; between them s = weight / 2 (n - mu t)^2.
    struct Contact { float mu, mu1, mu2, n, t1, t2, t, weight; State zone; };
    auto find_contact = [&](int r, float xn, float x1, float x2) {
        Contact c;
        c.mu = bound[r]; c.mu1 = bound[r + 1]; c.mu2 = bound[r + 2];
        c.n = c.mu * xn; c.t1 = c.mu1 * x1; c.t2 = c.mu2 * x2;
        c.t = sqrtf(c.t1 * c.t1 + c.t2 * c.t2);
        c.weight = D[r] / wp::max(TINY, c.mu * c.mu * (1.0f + c.mu * c.mu));
        c.zone = c.n >= c.mu * c.t ? SATISFIED : (c.mu * c.n + c.t <= 0.0f ? QUADRATIC : CONE);
        return c;
    };

    auto load = [&] {
        for (int e = lane; e < NV * WIDTH; e += LANES) M[e] = 0.0f;
        for (int i = lane; i < NV; i += LANES) {
            a[i] = has_smooth && rows == 0 ? wp::index(qacc_smooth, world, i) : wp::index(warmstart, world, i);
            smooth[i] = wp::index(qfrc_smooth, world, i);
        }
        for (int e = lane; e < rows * NV; e += LANES) {
            const int r = e / NV, i = e - r * NV;
            J[r * WIDTH + i] = wp::index(efc_J, world, r, i);
        }
        const float root = wp::index(impratio_invsqrt, world % impratio_invsqrt.shape[0]);
        for (int r = lane; r < rows; r += LANES) {
            Kind found = ONE_SIDED;
            float most = 0.0f;
            if (r < equalities) found = EQUALITY;
            else if (r < equalities + frictions) { found = FRICTION; most = wp::index(efc_frictionloss, world, r); }
            else if (wp::index(efc_type, world, r) == ELLIPTIC) {
                const int contact = wp::index(efc_id, world, r);
                const int normal = wp::index(contact_address, contact, 0);
                const wp::vec_t<5, float> coefficients = wp::index(contact_friction, contact);
                // A contact whose rows did not all fit has no force, as in the library.
                if (normal < 0 || normal + 2 >= rows) found = DROPPED;
                else if (r == normal) { found = NORMAL; most = coefficients[0] * root; }
                else { found = TANGENT; most = r == normal + 1 ? coefficients[0] : coefficients[1]; }
            }
            kind[r] = (unsigned char)found;
            state[r] = SATISFIED;
            bound[r] = most;
            force[r] = 0.0f;
            D[r] = wp::index(efc_D, world, r);
            x[r] = -wp::index(efc_aref, world, r);
        }
        wait();
        float diagonal = 0.0f;
        for (int i = lane; i < NV; i += LANES) {
            const int first = wp::index(M_rowadr, i), count = wp::index(M_rownnz, i);
            for (int k = 0; k < count; ++k) {
                const int j = wp::index(M_colind, first + k);
                const float value = wp::index(M_in, world, first + k);
                M[i * WIDTH + j] = value;
                M[j * WIDTH + i] = value;
                if (i == j) diagonal += value;
            }
        }
        wait();
        return sum_lanes(diagonal);
    };

    // out (NV) = M v
    auto multiply_inertia = [&](const float* v, float* out) {
        for (int i = lane; i < NV; i += LANES) {
            float value = 0.0f;
            for (int j = 0; j < NV; ++j) value += M[i * WIDTH + j] * v[j];
            out[i] = value;
        }
    };

    // Row r of J times v.
    auto multiply_row = [&](int r, const float* v) {
        float value = 0.0f;
        for (int j = 0; j < NV; ++j) value += J[r * WIDTH + j] * v[j];
        return value;
    };

    // Forces, states and the blocks of sliding contacts, at x. The lane of a normal row does its two tangential rows.
    auto update_forces = [&] {
        for (int r = lane; r < rows; r += LANES) {
            if (kind[r] == EQUALITY || (kind[r] == ONE_SIDED && x[r] < 0.0f)) {
                force[r] = -D[r] * x[r]; state[r] = QUADRATIC;
            } else if (kind[r] == ONE_SIDED) {
                force[r] = 0.0f; state[r] = SATISFIED;
            } else if (kind[r] == FRICTION) {  // Huber: s' = D x, at most the loss
                const float wanted = -D[r] * x[r];
                if (wanted >= bound[r]) { force[r] = bound[r]; state[r] = LINEAR_NEGATIVE; }
                else if (wanted <= -bound[r]) { force[r] = -bound[r]; state[r] = LINEAR_POSITIVE; }
                else { force[r] = wanted; state[r] = QUADRATIC; }
            } else if (kind[r] == NORMAL) {
                const Contact c = find_contact(r, x[r], x[r + 1], x[r + 2]);
                for (int k = 0; k < 3; ++k) {
                    state[r + k] = (unsigned char)c.zone;
                    force[r + k] = c.zone == QUADRATIC ? -D[r + k] * x[r + k] : 0.0f;
                }
                if (c.zone == CONE) {
                    const float inverse = 1.0f / wp::max(c.t, TINY), d1 = c.t1 * inverse, d2 = c.t2 * inverse;
                    const float press = -c.weight * (c.n - c.mu * c.t) * c.mu;
                    force[r] = press;
                    force[r + 1] = -press * d1 * c.mu1;
                    force[r + 2] = -press * d2 * c.mu2;
                    const float mu2 = c.mu * c.mu, bend = c.mu * c.n * inverse, w = c.weight;
                    block[3 * r + 0] = w * mu2;
                    block[3 * r + 1] = -w * mu2 * d1 * c.mu1;
                    block[3 * r + 2] = -w * mu2 * d2 * c.mu2;
                    block[3 * r + 3] = w * c.mu1 * c.mu1 * (bend * d1 * d1 + mu2 - bend);
                    block[3 * r + 4] = w * c.mu1 * c.mu2 * bend * d1 * d2;
                    block[3 * r + 5] = w * c.mu2 * c.mu2 * (bend * d2 * d2 + mu2 - bend);
                }
            }
        }
        wait();
    };

    // The gradient, as the row below the Hessian; returns its squared length.
    auto update_gradient = [&] {
        float squares = 0.0f;
        for (int i = lane; i < NV; i += LANES) {
            float value = 0.0f;
            for (int r = 0; r < rows; ++r) value += J[r * WIDTH + i] * force[r];
            pull[i] = value;
            value = Ma[i] - smooth[i] - value;
            y[i] = value;
            squares += value * value;
        }
        return sum_lanes(squares);
    };

    // The lower triangle of M + J' C J. A lane keeps its entries in registers; all lanes go through the rows together.
    auto update_hessian = [&] {
        int row[PAIRS_A_LANE], column[PAIRS_A_LANE];
        float sum[PAIRS_A_LANE];
        for (int e = 0; e < PAIRS_A_LANE; ++e) {
            const int pair = lane + e * LANES < PAIRS ? lane + e * LANES : PAIRS - 1;  // entry `pair` of row by row order
            int i = (int)((sqrtf(8.0f * pair + 1.0f) - 1.0f) * 0.5f);
            i += (i + 1) * (i + 2) / 2 <= pair ? 1 : 0;
            i -= i * (i + 1) / 2 > pair ? 1 : 0;
            row[e] = i;
            column[e] = pair - i * (i + 1) / 2;
            sum[e] = M[i * WIDTH + column[e]];
        }
        for (int r = 0; r < rows; ++r) {
            if (state[r] == QUADRATIC) {
                const float* Jr = J + r * WIDTH;
                for (int e = 0; e < PAIRS_A_LANE; ++e) sum[e] += Jr[row[e]] * (D[r] * Jr[column[e]]);
            } else if (state[r] == CONE && kind[r] == NORMAL) {
                const float *Jn = J + r * WIDTH, *Jt = Jn + WIDTH, *Ju = Jt + WIDTH, *c = block + 3 * r;
                for (int e = 0; e < PAIRS_A_LANE; ++e) {
                    const int i = row[e], j = column[e];
                    sum[e] += Jn[i] * (c[0] * Jn[j] + c[1] * Jt[j] + c[2] * Ju[j])
                            + Jt[i] * (c[1] * Jn[j] + c[3] * Jt[j] + c[4] * Ju[j])
                            + Ju[i] * (c[2] * Jn[j] + c[4] * Jt[j] + c[5] * Ju[j]);
                }
            }
        }
        for (int e = 0; e < PAIRS_A_LANE; ++e)
            if (lane + e * LANES < PAIRS) L[row[e] * WIDTH + column[e]] = sum[e];
        wait();
    };

    // Hessian = L L'; the gradient below becomes y = L^-1 gradient on the way. Returns y'y = gradient' Hessian^-1 gradient.
    auto factor = [&] {
        for (int k = 0; k < NV; ++k) {
            const float inverse = 1.0f / sqrtf(wp::max(L[k * WIDTH + k], 1e-12f));
            wait();
            for (int i = k + lane; i <= NV; i += LANES) L[i * WIDTH + k] *= inverse;
            wait();
            for (int i = k + 1 + lane; i <= NV; i += LANES) {
                const float own = L[i * WIDTH + k];
                const int last = i < NV ? i : NV - 1;
                for (int j = k + 1; j <= last; ++j) L[i * WIDTH + j] -= own * L[j * WIDTH + k];
            }
            wait();
        }
        float squares = 0.0f;
        for (int i = lane; i < NV; i += LANES) squares += y[i] * y[i];
        return sum_lanes(squares);
    };

    // search = -Hessian^-1 gradient = -L'^-1 y
    auto update_search = [&] {
        for (int k = NV - 1; k >= 0; --k) {
            const float value = y[k] / L[k * WIDTH + k];
            wait();
            for (int i = lane; i < k; i += LANES) y[i] -= L[k * WIDTH + i] * value;
            if (lane == 0) search[k] = -value;
            wait();
        }
    };

    // First and second derivative of all rows' costs by the step, and the sum of the first's magnitudes (to judge rounding).
    struct Derivatives { float first, second, magnitude; };
    auto differentiate_rows = [&](float step) {
        Derivatives sum = {0.0f, 0.0f, 0.0f};
        for (int r = lane; r < rows; r += LANES) {
            const float along = slope[r], at = x[r] + step * along;
            float first = 0.0f, second = 0.0f;
            if (kind[r] == EQUALITY || (kind[r] == ONE_SIDED && at < 0.0f)) {
                first = D[r] * at * along; second = D[r] * along * along;
            } else if (kind[r] == FRICTION) {
                const float wanted = D[r] * at;
                if (wanted >= bound[r]) first = bound[r] * along;
                else if (wanted <= -bound[r]) first = -bound[r] * along;
                else { first = wanted * along; second = D[r] * along * along; }
            } else if (kind[r] == NORMAL) {
                const float at1 = x[r + 1] + step * slope[r + 1], at2 = x[r + 2] + step * slope[r + 2];
                const Contact c = find_contact(r, at, at1, at2);
                if (c.zone == QUADRATIC) {
                    first = D[r] * at * along + D[r + 1] * at1 * slope[r + 1] + D[r + 2] * at2 * slope[r + 2];
                    second = D[r] * along * along + D[r + 1] * slope[r + 1] * slope[r + 1]
                           + D[r + 2] * slope[r + 2] * slope[r + 2];
                } else if (c.zone == CONE) {
                    const float inverse = 1.0f / wp::max(c.t, TINY);
                    const float v1 = c.mu1 * slope[r + 1], v2 = c.mu2 * slope[r + 2], turn = c.t1 * v2 - c.t2 * v1;
                    const float t_first = (c.t1 * v1 + c.t2 * v2) * inverse, t_second = turn * turn * inverse * inverse * inverse;
                    const float gap = c.n - c.mu * c.t, gap_first = c.mu * along - c.mu * t_first;
                    first = c.weight * gap * gap_first;
                    second = c.weight * (gap_first * gap_first - gap * c.mu * t_second);
                }
            }
            sum.first += first; sum.second += second; sum.magnitude += wp::abs(first);
        }
        sum.first = sum_lanes(sum.first); sum.second = sum_lanes(sum.second); sum.magnitude = sum_lanes(sum.magnitude);
        return sum;
    };

    // --- The method ------------------------------------------------------------------------------------------------------------
    const float inertia = load();
    const float scale = 1.0f / wp::max(TINY, inertia);  // makes costs comparable between scenes, as in the library
    const float enough = wp::index(tolerance, world % tolerance.shape[0]);
    const float line_enough = wp::index(ls_tolerance, world % ls_tolerance.shape[0]);
    multiply_inertia(a, Ma);
    for (int r = lane; r < rows; r += LANES) x[r] += multiply_row(r, a);
    wait();

    int iteration = 0;
    bool converged = false;
    float step = 1.0f, improvement = 0.0f;
    while (true) {
        update_forces();
        const float gradient = scale * sqrtf(update_gradient());
        if (iteration > 0) {
            const bool stuck = step == 0.0f || (improvement > 0.0f && scale * improvement < enough);
            converged = stuck || gradient < enough;
            if (converged || iteration == iterations) break;
        }
        update_hessian();
        const float decrement = factor();
        // 1/2 decrement is what the quadratic model still gains. A good warm start ends here without a step.
        converged = 0.5f * scale * decrement < enough;
        if (converged) break;
        update_search();

        // Exact line search: the root of the derivative, which only grows, by Newton's method between two ends.
        multiply_inertia(search, Msearch);
        for (int r = lane; r < rows; r += LANES) slope[r] = multiply_row(r, search);
        wait();
        float inertial_first = 0.0f, inertial_second = 0.0f, length = 0.0f;
        for (int i = lane; i < NV; i += LANES) {
            inertial_first += search[i] * (Ma[i] - smooth[i]);
            inertial_second += search[i] * Msearch[i];
            length += search[i] * search[i];
        }
        inertial_first = sum_lanes(inertial_first); inertial_second = sum_lanes(inertial_second); length = sum_lanes(length);
        const float flat = wp::max(enough * line_enough * sqrtf(length) / scale, 1e-6f);
        float low = 0.0f, high = -1.0f, derivative = 0.0f;  // high < 0: no upper end yet
        bool found = false;
        step = 1.0f;
        for (int trial = 0; trial < ls_iterations; ++trial) {
            const Derivatives rows_part = differentiate_rows(step);
            const float inertial = inertial_first + step * inertial_second;
            derivative = inertial + rows_part.first;
            const float rounding = 9.5e-7f * (wp::abs(inertial) + rows_part.magnitude);  // 8 units in the last place
            found = wp::abs(derivative) <= wp::max(flat, rounding);
            if (found) break;
            (derivative < 0.0f ? low : high) = step;
            float next = step - derivative / wp::max(inertial_second + rows_part.second, TINY);
            if (high > 0.0f) { if (!(next > low && next < high)) next = 0.5f * (low + high); }
            else if (!(next > low)) next = 2.0f * low;
            found = next == step;
            if (found) break;
            step = next;
        }
        if (!found && low > 0.0f) step = low;  // certain to lower the cost
        improvement = 0.5f * step * (decrement - derivative);

        for (int i = lane; i < NV; i += LANES) { a[i] += step * search[i]; Ma[i] += step * Msearch[i]; }
        for (int r = lane; r < rows; r += LANES) x[r] += step * slope[r];
        ++iteration;
        wait();
    }

    for (int i = lane; i < NV; i += LANES) {
        wp::index(qacc, world, i) = a[i];
        wp::index(efc_Ma, world, i) = Ma[i];
        wp::index(qfrc_constraint, world, i) = pull[i];
    }
    for (int r = lane; r < rows; r += LANES) {
        wp::index(efc_force, world, r) = force[r];
        wp::index(efc_state, world, r) = state[r];
    }
    if (lane == 0) {
        wp::index(solver_niter, world) = iteration;
        if (!converged) wp::index(overflow, world) = wp::index(overflow, world) | TOO_FEW_ITERATIONS;
    }
#undef NEWTON_SHARED
