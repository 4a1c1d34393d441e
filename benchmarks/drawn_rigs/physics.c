// SPDX-License-Identifier: Apache-2.0
// Emulated rigs of one or two axes, stepped at 0.1 ms, under the firmware of their servos. SI units throughout.
//
// physics.py puts an enum before this file: the columns of `rig` and `axes`, in the order of its tables.
// Smooth forces: explicit midpoint. Dry friction: an impulse in each step that may stop a joint and never turn it around
// (Moreau 1988), so sticking is exact and nothing is regularised. Belts and slack: penalty, stiff but resolved.
#include <math.h>
#include <string.h>

#define MOST 2
#define G 9.81
#define TURN 6.283185307179586
#define STEP 1e-4
#define SWEEPS 20

typedef struct {
  const double *rig, *axes;
  int n;
  double motor[MOST], motor_speed[MOST], load[MOST], load_speed[MOST];
  double held[2 * MOST];       // friction impulses of the last step, per second
  double bristle[MOST], mount[MOST];
  double goal[MOST], goal_speed[MOST], sum[MOST], last[MOST], wanted[MOST], torque[MOST];
  double supply, age, asked[MOST];  // s for which much of the full duty has been asked for
} State;

static double of(const State *s, int axis, int name) { return s->axes[axis * AXIS_COUNT + name]; }
static double clamp(double x, double low, double high) { return x < low ? low : x > high ? high : x; }
static double sign(double x) { return (x > 0) - (x < 0); }

// Torque that a belt (or a gear's spring) passes on: spring and damper outside of the slack, nothing within it.
static double passed(const State *s, int a, double stretch, double rate, int *slack) {
  double half = 0.5 * of(s, a, GAP), beyond = stretch - clamp(stretch, -half, half);
  double stiffness = of(s, a, STIFFNESS), damping = of(s, a, DAMPING);
  *slack = half > 0 && beyond == 0;
  if (*slack) return 0;
  double bent = beyond * of(s, a, HARDENING);
  double torque = stiffness * beyond * (1 + bent * bent);
  if (half > 0 && of(s, a, CONTACT) > 0)  // Hunt and Crossley 1975: a damper that grows from nothing as surfaces meet
    return torque * fmax(1 + of(s, a, CONTACT) * rate * sign(beyond), 0);
  return torque + damping * rate;
}

// Mass matrix of the loads, and the torques on them that depend on the pose and on speeds.
static void loads(const State *s, const double *q, const double *w, double mass[MOST][MOST], double *torque) {
  double sine[MOST], cosine[MOST];
  for (int a = 0; a < s->n; a++) {
    mass[a][a] = of(s, a, INERTIA);
    torque[a] = -of(s, a, LOAD_DAMPING) * w[a] - of(s, a, SPRING) * q[a] * (1 + pow(of(s, a, SPRING_HARDENING) * q[a], 2));
    double stop = of(s, a, STOP), over = q[a] - clamp(q[a], -stop, stop);
    if (over != 0) torque[a] -= 3000 * over + 3 * w[a];
  }
  if (s->rig[BOARD] > 0) {  // two nested frames, balanced, y within x
    for (int a = 0; a < s->n; a++) sine[a] = sin(q[a]), cosine[a] = cos(q[a]);
    double tilt = s->rig[TILT], turn = tilt * 2 * sine[1] * cosine[1];
    mass[0][0] += tilt * sine[1] * sine[1];
    mass[0][1] = mass[1][0] = 0;
    torque[0] += G * of(s, 0, SIDEWAYS) * cosine[0] - turn * w[0] * w[1];
    torque[1] += G * of(s, 1, SIDEWAYS) * cosine[1] * cosine[0] + 0.5 * turn * w[0] * w[0];
    return;
  }
  torque[0] += G * (of(s, 0, SIDEWAYS) * cos(q[0]) - of(s, 0, BELOW) * sin(q[0]));
  if (s->n == 1) return;
  // Two links in a vertical plane, hanging down at zero; the second's angle is relative to the first.
  double length = s->rig[LINK], below = of(s, 1, BELOW), sideways = of(s, 1, SIDEWAYS), carried = of(s, 1, MASS);
  double c = cos(q[1]), d = sin(q[1]), across = length * (sideways * d + below * c);
  double change = length * (sideways * c - below * d), both = q[0] + q[1];
  double inner = mass[1][1];
  mass[0][0] += carried * length * length + inner + 2 * across;
  mass[0][1] = mass[1][0] = inner + across;
  double outer = G * (sideways * cos(both) - below * sin(both));
  torque[0] += outer - G * carried * length * sin(q[0]) - change * (2 * w[0] * w[1] + w[1] * w[1]);
  torque[1] += outer + change * w[0] * w[0];
}

// Friction of a motor's gear that is no switching law: viscous, fast and magnetic torques.
static double smooth(const State *s, int a, double q, double w) {
  double viscous = of(s, a, VISCOUS) * w;
  if (of(s, a, THINNING) > 0) viscous /= 1 + fabs(w) / of(s, a, THINNING);
  double torque = of(s, a, PULL) - viscous - of(s, a, DRAG) * w * fabs(w);
  torque -= of(s, a, UPWARD_VISCOUS) * fmax(w, 0) + of(s, a, DOWNWARD_VISCOUS) * fmin(w, 0);
  if (of(s, a, COGGING) != 0) torque += of(s, a, COGGING) * sin(TURN * q / of(s, a, COGGING_PERIOD));
  return torque;
}

// Largest dry friction of a motor for each direction of turning, given the torques that its gear carries.
static void dry(const State *s, int a, double time, double w, double motor, double outside, double *up, double *down) {
  double level = of(s, a, COULOMB), extra = of(s, a, STRIBECK);
  if (extra > 0) {
    double slow = fabs(w) / of(s, a, STRIBECK_SPEED);
    int form = (int)of(s, a, STRIBECK_FORM);
    level += extra * (form == 0 ? exp(-slow * slow) : form == 1 ? 1 / (1 + slow * slow) : exp(-slow));
  }
  double driving = of(s, a, LOAD_DRIVING), driven = of(s, a, LOAD_DRIVEN);
  if (driving > 0 || driven > 0) {
    double share = fabs(motor) >= fabs(outside) ? driving : driven;
    double carried = of(s, a, LOAD_FORM) > 0 ? 2 * fabs(outside) : fabs(motor - outside);
    level += share * carried;
  }
  if (of(s, a, OTHER_FRICTION) > 0 && s->n > 1) level += of(s, a, OTHER_FRICTION) * fabs(s->load[1 - a]);
  if (of(s, a, TIGHT) > 0) level += of(s, a, TIGHT) * fmax(sin(TURN * s->motor[a] / of(s, a, TIGHT_PERIOD)), 0);
  level *= 1 + of(s, a, WARMING) * exp(-(s->age + time) / 20.0);
  *up = level + of(s, a, UPWARD);
  *down = level + of(s, a, DOWNWARD);
}

// Accelerations of all joints: motors first, then loads; where nothing yields between them, the motors' alone.
static void accelerate(State *s, const double *torque, const double *qm, const double *wm, const double *ql,
                       const double *wl, double *acc, double weight[MOST][MOST], double *outside, int *slack) {
  double mass[MOST][MOST] = {{0}}, on[MOST];
  int yields = s->rig[YIELDS] > 0, n = s->n;
  loads(s, ql, wl, mass, on);
  double motor[MOST];
  for (int a = 0; a < n; a++) {
    motor[a] = torque[a] + smooth(s, a, qm[a], wm[a]);
    slack[a] = 0;
    if (!yields) outside[a] = on[a];
  }
  for (int a = 0; a < n && yields; a++) outside[a] = 0;
  for (int a = 0; a < n && yields; a++) {
    double ratio = 1, share = n > 1 ? of(s, a, CROSS) : 0;
    double uneven = of(s, a, UNEVEN) != 0 ? of(s, a, UNEVEN) * sin(TURN * qm[a] / of(s, a, UNEVEN_PERIOD)) : 0;
    double stretch = ratio * qm[a] + uneven - ql[a] + (share != 0 ? share * ql[1 - a] : 0);
    double rate = ratio * wm[a] - wl[a] + (share != 0 ? share * wl[1 - a] : 0);
    double belt = passed(s, a, stretch, rate, &slack[a]);
    outside[a] -= ratio * belt;
    on[a] += belt;
    if (share != 0) on[1 - a] -= share * belt;
  }
  if (yields) {
    for (int a = 0; a < n; a++) acc[a] = (motor[a] + outside[a]) / of(s, a, ARMATURE);
  } else {
    for (int a = 0; a < n; a++) mass[a][a] += of(s, a, ARMATURE), on[a] += motor[a];
  }
  double *load = yields ? acc + n : acc;
  if (n == 1) {
    weight[0][0] = 1 / mass[0][0];
    load[0] = on[0] / mass[0][0];
    return;
  }
  double det = mass[0][0] * mass[1][1] - mass[0][1] * mass[1][0];
  weight[0][0] = mass[1][1] / det, weight[1][1] = mass[0][0] / det;
  weight[0][1] = weight[1][0] = -mass[0][1] / det;
  load[0] = weight[0][0] * on[0] + weight[0][1] * on[1];
  load[1] = weight[1][0] * on[0] + weight[1][1] * on[1];
}

// Torque against a bristle that yields before it slides: LuGre (Canudas de Wit 1995), Dahl (1968).
static double bristles(State *s, int a, double w, double level) {
  double stiff = of(s, a, BRISTLE), z = s->bristle[a], next;
  if (of(s, a, FRICTION_FORM) == 3) {
    double way = 1 - stiff * z * sign(w) / level;
    next = z + STEP * w * way * fabs(way);
  } else {
    next = (z + STEP * w) / (1 + STEP * stiff * fabs(w) / level);
  }
  s->bristle[a] = next;
  return stiff * next + of(s, a, BRISTLE_DAMPING) * (next - z) / STEP;
}

// Share of the full duty that a firmware gives which protects its motor: all of it, until much was asked for too long.
static double cut_back(const State *s, int a) {
  return of(s, a, CUT_SHARE) < 1 && s->asked[a] > of(s, a, CUT_TIME) ? of(s, a, CUT_SHARE) : 1;
}

// What the motor gives now of what its firmware wants: current limit, torque-speed line, supply.
static double given(const State *s, int a, double w) {
  double most = of(s, a, TORQUE) * of(s, a, TORQUE_SHARE) * cut_back(s, a), wanted = s->wanted[a];
  if (of(s, a, LAW) == 2) {
    double emf = of(s, a, CONSTANT) * of(s, a, CONSTANT) / of(s, a, RESISTANCE) * w;
    double full = of(s, a, CONSTANT) * of(s, a, VOLTAGE) / of(s, a, RESISTANCE);
    double share = of(s, a, TORQUE_SHARE) * cut_back(s, a), duty = clamp(wanted, -share, share);
    if (of(s, a, SOFT_LIMIT) > 0) duty = share * tanh(wanted / share);
    return full * duty * s->supply - emf;
  }
  if (of(s, a, SOFT_LIMIT) > 0) wanted = most * tanh(wanted / most);
  double line = w / of(s, a, NO_LOAD);  // no torque is left at the no-load speed
  double full = of(s, a, TORQUE);
  // Beyond it the motor brakes, as the current flows back through the bridge.
  double high = fmax(fmin(most, full * (s->supply - line)), -most);
  double low = fmin(fmax(-most, -full * (s->supply + line)), most);
  return clamp(wanted, low, high);
}

static double uneven_sensor(const State *s, int a, double q) {
  double size = of(s, a, FEEDBACK_ERROR), part;
  if (size == 0) return 0;
  double turns = q / of(s, a, FEEDBACK_PERIOD) + of(s, a, FEEDBACK_PHASE);
  if (of(s, a, FEEDBACK_FORM) > 0) {  // a saw tooth
    part = turns - floor(turns) - 0.5;
    return size * 2 * part;
  }
  return size * sin(TURN * turns);
}

// One round of the firmware: profile, error, law.
static void firmware(State *s, const double *target, double dt, double push[MOST]) {
  for (int a = 0; a < s->n; a++) {
    double rate = of(s, a, RATE);
    if (rate > 0) {
      double way = target[a] - s->goal[a], limit = of(s, a, RATE_ACCELERATION);
      double speed = limit > 0 ? sign(way) * fmin(rate, sqrt(2 * limit * fabs(way))) : sign(way) * rate;
      if (limit > 0) speed = s->goal_speed[a] + clamp(speed - s->goal_speed[a], -limit * dt, limit * dt);
      double move = fabs(speed * dt) < fabs(way) || limit > 0 ? speed * dt : way;
      if (limit > 0 && fabs(way) < fabs(move) && fabs(speed) <= 2 * limit * dt) move = way, speed = 0;
      s->goal[a] += move;
      s->goal_speed[a] = speed;
    } else {
      s->goal[a] = target[a];
    }
    double tick = of(s, a, FEEDBACK_TICK), angle = s->motor[a] - s->mount[a] + uneven_sensor(s, a, s->motor[a]);
    if (tick > 0) angle = tick * floor(angle / tick + 0.5);
    double error = s->goal[a] - angle, band = of(s, a, DEAD_BAND);
    if (band > 0) {
      if (of(s, a, DEAD_BAND_FORM) > 0) error = fabs(error) <= band ? 0 : error;
      else error -= clamp(error, -band, band);
    }
    double speed = s->motor_speed[a];
    int law = (int)of(s, a, LAW);
    if (law == 0) {
      s->sum[a] += error * dt;
      double want = of(s, a, P) * error + of(s, a, I) * s->sum[a] + of(s, a, D) * 0.01 * (error - s->last[a]) / dt;
      s->wanted[a] = of(s, a, GAIN) * (want - speed) + push[a];
    } else if (law == 1) {
      s->wanted[a] = of(s, a, P) * error - of(s, a, D) * speed + push[a];
    } else {
      double full = of(s, a, CONSTANT) * of(s, a, VOLTAGE) / of(s, a, RESISTANCE);
      s->wanted[a] = of(s, a, P) * of(s, a, GAIN) * error + push[a] / full;
    }
    s->last[a] = error;
    double full = law == 2 ? 1 : of(s, a, TORQUE);
    s->asked[a] = fabs(s->wanted[a]) >= of(s, a, CUT_BOUND) * full ? s->asked[a] + dt : 0;
  }
  double sag = s->rig[SAG], drawn = 0;
  if (sag <= 0) return;
  double level = s->supply, aim = level;
  for (int round = 0; round < 30; round++) {  // the supply's voltage and the motors' duties together
    drawn = 0;
    for (int a = 0; a < s->n; a++) {
      double pwm = of(s, a, LAW) == 2, full = pwm ? 1 : of(s, a, TORQUE);
      double line = (pwm ? s->motor_speed[a] * of(s, a, CONSTANT) / of(s, a, VOLTAGE)
                         : s->motor_speed[a] / fmin(of(s, a, NO_LOAD), 1e9)) * sign(s->wanted[a]);
      double torque = fmin(fabs(s->wanted[a]) / full, fmax(pwm ? 1 : aim - line, 0));
      double current = pwm ? fmax(torque * aim - line, 0) : torque;
      double duty = clamp(pwm ? torque : (torque + line) / fmax(aim, 0.05), 0, 1);
      drawn += duty * current;
    }
    aim += 0.3 * (clamp(1 - sag * drawn, 0.05, 1) - aim);
  }
  double time = s->rig[SAG_TIME];
  s->supply = time > 0 ? level + (aim - level) * (1 - exp(-dt / time)) : aim;
}

static void step(State *s, double time) {
  int n = s->n, yields = s->rig[YIELDS] > 0, joints = yields ? 2 * n : n, slack[MOST];
  double acc[2 * MOST], mid[2 * MOST], weight[MOST][MOST], outside[MOST];
  double *qm = s->motor, *wm = s->motor_speed, *ql = s->load, *wl = s->load_speed;
  double qm2[MOST], wm2[MOST], ql2[MOST], wl2[MOST], next[2 * MOST], high[2 * MOST], low[2 * MOST];
  for (int a = 0; a < n; a++) s->torque[a] = given(s, a, wm[a]);
  accelerate(s, s->torque, qm, wm, ql, wl, acc, weight, outside, slack);
  for (int a = 0; a < n; a++) {
    double rub = yields ? s->held[a] / of(s, a, ARMATURE) : 0;
    if (!yields)
      for (int b = 0; b < n; b++) rub += weight[a][b] * s->held[b];
    qm2[a] = qm[a] + 0.5 * STEP * wm[a];
    wm2[a] = wm[a] + 0.5 * STEP * (acc[a] + rub);
    ql2[a] = yields ? ql[a] + 0.5 * STEP * wl[a] : qm2[a];
    wl2[a] = yields ? wl[a] + 0.5 * STEP * acc[n + a] : wm2[a];
  }
  accelerate(s, s->torque, qm2, wm2, ql2, wl2, mid, weight, outside, slack);
  for (int a = 0; a < n; a++) {
    next[a] = wm[a] + STEP * mid[a];
    if (yields) next[n + a] = wl[a] + STEP * mid[n + a];
  }
  for (int a = 0; a < n; a++) {
    double up, down;
    dry(s, a, time, wm[a], s->torque[a], outside[a], &up, &down);
    int form = (int)of(s, a, FRICTION_FORM);
    double against = 0;
    if (form == 1) against = (wm[a] > 0 ? up : down) * tanh(wm[a] / of(s, a, SMOOTH_SPEED));
    if (form >= 2 && up > 0) against = bristles(s, a, wm[a], wm[a] > 0 ? up : down);
    if (form > 0) {
      up = down = 0;
      for (int b = 0; b < n; b++) next[b] -= STEP * against * (yields ? (a == b ? 1 / of(s, a, ARMATURE) : 0) : weight[b][a]);
    }
    high[a] = STEP * down, low[a] = -STEP * up;
    double rub = STEP * (of(s, a, LOAD_COULOMB) + (slack[a] ? of(s, a, HOLD) : 0));
    if (yields) high[n + a] = rub, low[n + a] = -rub;
    else high[a] += rub, low[a] -= rub;
  }
  // Friction impulses that bring each joint to rest, or as near as its bound lets them.
  double impulse[2 * MOST] = {0};
  for (int sweep = 0; sweep < SWEEPS; sweep++) {
    double moved = 0;
    for (int j = 0; j < joints; j++) {
      if (high[j] <= low[j]) continue;
      int motor = yields && j < n, a = j % n;
      double own = motor ? 1 / of(s, a, ARMATURE) : weight[a][a];
      double now = clamp(impulse[j] - next[j] / own, low[j], high[j]), change = now - impulse[j];
      impulse[j] = now;
      moved = fmax(moved, fabs(change) * own);
      if (motor) next[j] += change * own;
      else
        for (int b = 0; b < n; b++) next[(yields ? n : 0) + b] += change * weight[b][a];
    }
    if (moved < 1e-12 || n == 1 || (yields && weight[0][1] == 0)) break;
  }
  for (int j = 0; j < joints; j++) s->held[j] = impulse[j] / STEP;
  for (int a = 0; a < n; a++) {
    qm[a] += 0.5 * STEP * (wm[a] + next[a]);
    wm[a] = next[a];
    if (yields) {
      ql[a] += 0.5 * STEP * (wl[a] + next[n + a]);
      wl[a] = next[n + a];
    } else {
      ql[a] = qm[a], wl[a] = wm[a];
    }
    double play = of(s, a, MOUNT_PLAY);  // the servo's own body gives way to its torque, against friction, up to a stop
    if (play > 0) {
      double beyond = -s->torque[a] - clamp(-s->torque[a], -of(s, a, MOUNT_FRICTION), of(s, a, MOUNT_FRICTION));
      s->mount[a] = clamp(s->mount[a] + STEP * beyond / of(s, a, MOUNT_DAMPING), -0.5 * play, 0.5 * play);
    }
  }
}

// Plays the goals of one trial.
//   count: of axes; times, goals: (count, events) s and rad, when a goal reaches the firmware; start: (count,) rad.
//   lead: s before time zero; rounds: firmware rounds in all, `every` steps each; push: (rounds, count) N m.
//   out: (rows, count, 5): angle and speed of the motor against its mount, angle and speed of the load, torque;
//   a row every `record` steps from time zero on. Returns 0, or 1 where a number has left all bounds.
int play(const double *rig, const double *axes, int count, const double *times, const double *goals, int events,
         const double *start, double lead, double age, int rounds, int every, int record, int rows, const double *push,
         double *out) {
  State s;
  memset(&s, 0, sizeof s);
  s.rig = rig, s.axes = axes, s.n = count, s.supply = 1, s.age = age;
  int at[MOST] = {0}, row = 0;
  for (int a = 0; a < count; a++) s.motor[a] = s.load[a] = s.goal[a] = start[a];
  long now = 0, zero = lround(lead / STEP);
  for (int round = 0; round < rounds && row < rows; round++) {
    double time = now * STEP - lead, target[MOST], pushed[MOST];
    for (int a = 0; a < count; a++) {
      const double *when = times + a * events;
      while (at[a] + 1 < events && when[at[a] + 1] <= time + 1e-9) at[a]++;
      target[a] = goals[a * events + at[a]];
      pushed[a] = push[round * count + a];
    }
    if (round == 0) for (int a = 0; a < count; a++) s.last[a] = target[a] - s.motor[a];
    firmware(&s, target, every * STEP, pushed);
    for (int k = 0; k < every && row < rows; k++) {
      if (now >= zero && (now - zero) % record == 0) {
        for (int a = 0; a < count; a++) {
          double *to = out + (row * count + a) * 5;
          to[0] = s.motor[a] - s.mount[a], to[1] = s.motor_speed[a], to[2] = s.load[a], to[3] = s.load_speed[a];
          to[4] = given(&s, a, s.motor_speed[a]);
          if (!(fabs(to[0]) < 1e3) || !(fabs(to[2]) < 1e3)) return 1;
        }
        row++;
      }
      step(&s, now * STEP - lead);
      now++;
    }
  }
  return 0;
}
