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

function limit = limit_of(c, nu)
% The stretch at which 1 - c (w / 1 mm)^nu vanishes, that nothing passes.
limit = Inf;
if c > 0
    limit = 1e-3 * (1 / c)^(1 / nu);
end
end

function x = way_to(c, w, nu)
% Integral of 1 / (1 - c |t / 1 mm|^nu) from 0 to w, by Gauss and Legendre in t = w s^k.
% Near the limit of the stretch the pole z / (nu (1 - z)), z = t / limit, is taken out and known.
s = [{{ legendre | map("first") | map("number") | join(", ") }}];
weight = [{{ legendre | map("last") | map("number") | join(", ") }}];
k = ceil(3 / nu);
weight = k * weight .* s.^(k - 1);
limit = limit_of(c, nu);
if w <= 0.5 * limit
    lost = c * (w / 1e-3 * s.^k).^nu;
    x = w + w * sum(weight .* lost ./ (1 - lost));
else
    near = w / limit;
    gap = max(1 - near, 1e-300);
    log_z = log1p(-gap) + k * log(s);
    pole = near * s.^k / nu ./ -expm1(log_z);
    rest = exp(nu * log_z) ./ -expm1(nu * log_z) - pole;
    x = w + w * (sum(weight .* rest) + (-log(gap) - near) / (nu * near));
end
end

function w = stretch_at(c, way, nu)
% The stretch that lies so far along the way: by halving, and one step of Newton's.
low = 0;
high = min(16 * way, limit_of(c, nu) * (1 - 1e-15));
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
