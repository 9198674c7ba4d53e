function [force, m] = masing_exponential(p, m, from, to, v)
% Masing's law of the exponential virgin curve.
[force, m] = masing(@(x) p(1) * approach(p(2), x), m, from, to);
end
