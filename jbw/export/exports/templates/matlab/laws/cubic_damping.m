function [force, m] = cubic_damping(p, m, from, to, v)
% Damper c v^3.
force = p(1) * v^3;
end
