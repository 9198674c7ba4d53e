function [force, m] = iwan4(p, m, from, to, v)
% Iwan's sliders by Segalman's four parameters; the loss of stiffness is stated at 1 mm.
q = 1 + p(3);
secant = p(1) / ((1 + p(4)) * (1 + q));
macroslip = 1e-3 * (secant / p(2))^(1 / q);
virgin = @(x) (p(1) - secant * min(x / macroslip, 1)^q) * min(x, macroslip);
[force, m] = masing(virgin, m, from, to);
end
