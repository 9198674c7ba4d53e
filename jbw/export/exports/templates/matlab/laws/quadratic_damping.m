function [force, m] = quadratic_damping(p, m, from, to, v)
% Damper c v|v|.
force = p(1) * v * abs(v);
end
