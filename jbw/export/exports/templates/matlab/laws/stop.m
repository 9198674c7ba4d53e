function [force, m] = stop(p, m, from, to, v)
% Two-sided stop, of stiffness p(1) beyond p(2).
force = p(1) * side_of(to) * max(abs(to) - p(2), 0);
end
