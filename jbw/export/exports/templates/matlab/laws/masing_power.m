function [force, m] = masing_power(p, m, from, to, v)
% Masing's law of stiffness lost by a power of the amplitude; the loss is stated at 1 mm.
[force, m] = masing(@(x) -p(1) * (x / 1e-3)^p(2) * x, m, from, to);
end
