function [force, m] = bouc_wen_nu(p, m, from, to, v)
% Bouc-Wen's law of any exponent; remembers the stretch w = z / alpha.
less = p(2) - p(3);
more = p(2) + p(3);
w = m(1);
side = side_of(to - from);
left = abs(to - from);
if left > 0
    if side * w < 0
        begun = way_to(less, abs(w), p(4));
        if left < begun
            w = -side * stretch_at(less, begun - left, p(4));
        else
            w = side * stretch_at(more, left - begun, p(4));
        end
    else
        w = side * stretch_at(more, way_to(more, abs(w), p(4)) + left, p(4));
    end
end
m(1) = w;
force = p(1) * w;
end

function x = way_to(c, w, nu)
% Integral of 1 / (1 - c |t / 1 mm|^nu) from 0 to w, by Gauss and Legendre in t = w s^k.
s = [{{ legendre | map("first") | map("number") | join(", ") }}];
weight = [{{ legendre | map("last") | map("number") | join(", ") }}];
k = max(1, 2 / nu);
x = w * sum(k * weight .* s.^(k - 1) ./ (1 - c * (w / 1e-3)^nu * s.^(k * nu)));
end

function w = stretch_at(c, way, nu)
% The stretch that lies so far along the way: by halving, and one step of Newton's.
low = 0;
high = 16 * way;
if c > 0
    high = min(high, 1e-3 * (1 / c)^(1 / nu) * (1 - 1e-15));
end
for i = 1:60
    w = (low + high) / 2;
    if way_to(c, w, nu) > way
        high = w;
    else
        low = w;
    end
end
w = (low + high) / 2;
w = w - (way_to(c, w, nu) - way) * (1 - c * (w / 1e-3)^nu);
end
