function x = approach(c, x)
% x P(c x), the approach (1 - exp(-c x)) / c without 0/0.
a = c * x;
if a ~= 0
    x = -x * expm1(-a) / a;
end
end

function w = way_to_zero(c, w)
% The way over which a stretch w relaxes to zero at the rate c, log(1 + c w) / c.
a = c * w;
if a <= -1
    w = Inf;
elseif a ~= 0
    w = w * log1p(a) / a;
end
end

function s = side_of(x)
s = 1;
if x < 0
    s = -1;
end
end

function z = bouc_wen_moved(p, z, dy)
% Bouc-Wen's force after a monotone move: dz/dy = alpha - gamma sgn(dy) z - delta |z|.
side = side_of(dy);
left = abs(dy);
z = side * z;
if z < 0
    c = p(3) - p(2);
    release = way_to_zero(c, -z / p(1));
    if left <= release
        z = side * (z + (p(1) - c * z) * approach(c, left));
        return
    end
    left = left - release;
    z = 0;
end
c = p(3) + p(2);
z = side * (z + (p(1) - c * z) * approach(c, left));
end

function [force, m] = masing(virgin, m, from, to)
% Masing's rules: m is sense, number of reversals, force, their displacements and their forces, the
% latest one first; the oldest is where the virgin curve begins.
places = 10;
y = m(4:3 + places);
f = m(4 + places:3 + 2 * places);
if m(1) * (to - from) < 0 || (m(1) == 0 && to ~= from)
    if m(2) == places  % full: keeps its two oldest and gives up the pair before them
        y = [from, y(1:places - 4), y(places - 1:places), 0];
        f = [m(3), f(1:places - 4), f(places - 1:places), 0];
        m(2) = m(2) - 1;
    else
        y = [from, y(1:places - 1)];
        f = [m(3), f(1:places - 1)];
        m(2) = m(2) + 1;
    end
    m(1) = side_of(to - from);
end
while m(2) > 1
    place = y(2);
    pops = 2;
    if m(2) == 2
        place = 2 * y(2) - y(1);
        pops = 1;
    end
    if m(1) * (to - place) < -1e-14 * (abs(to) + abs(y(1)))
        break
    end
    y = [y(pops + 1:end), zeros(1, pops)];
    f = [f(pops + 1:end), zeros(1, pops)];
    m(2) = m(2) - pops;
end
stretch = 1 + (m(2) > 1);
if m(2) > 0
    m(3) = f(1) + m(1) * stretch * virgin(max(m(1) * (to - y(1)), 0) / stretch);
end
m(4:3 + 2 * places) = [y, f];
force = m(3);
end
