function [force, m] = cubic(p, m, from, to, v)
% Spring c y^3.
force = p(1) * to^3;
end
