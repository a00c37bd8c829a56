// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Providers} from "./Providers.sol";
import {IOrganization} from "./interfaces/IOrganization.sol";
import {Agreement, Cover, Ended, IProviders, Outcome, Profile, Terms} from "./interfaces/IProviders.sol";
import {IServiceListener} from "./interfaces/IServiceListener.sol";
import {
    Choice,
    Free,
    Hire,
    IServiceManager,
    MAX_SERVICES,
    Release,
    Service,
    ServiceState
} from "./interfaces/IServiceManager.sol";
import {Texts} from "./libraries/Texts.sol";
import {Units} from "./libraries/Units.sol";
import {WeightTree} from "./libraries/WeightTree.sol";
import {KindId} from "./types/KindId.sol";
import {Passed} from "./types/Passed.sol";
import {NO_SERVICE, ServiceId, unpackService} from "./types/ServiceId.sol";
import {NO_TASK, TaskId} from "./types/TaskId.sol";
import {MAX_NUMBER, NO_TURN, Turn} from "./types/Turn.sol";
import {MAX_MAJOR, MAX_MINOR, Weight, weigh} from "./types/Weight.sol";

contract ServiceManager is IServiceManager {
    using WeightTree for WeightTree.Tree;

    /// @dev A Service in two words, of which tasks write the second one.
    struct Record {
        address provider;
        /// @dev The price in `_unit`.
        uint64 units;
        KindId kindId;
        ServiceState state;
        /// @dev A task has named it, or its provider, and waited, so that its own queue, or both, have to be looked at.
        Hire hired;
        bool autoAccept;
        Turn turn;
    }

    /// @dev Idle services of one kind, price and reputation, in order of their places: a linked list, because
    /// services leave it in the middle and DoubleEndedQueue lets go at its ends alone.
    struct Line {
        uint32 first;
        /// @dev Keeps the word of an empty line, which the next service of that price and reputation fills.
        bool used;
        /// @dev The last six at most, 32 bits each, the last of all in the lowest. Only earlier ones know the next by
        /// themselves, so that whoever joins a short line writes to no neighbour: 5,000 gas.
        uint192 latest;
    }

    /// @dev The idle services of a kind. The tree has one key per line, so that the usual case of few prices does
    /// not climb it: price, then the best reputation first. Its weights are the age of the line's first service
    /// (major) and the line's reputation (minor). The oldest line may have the age of an earlier first service.
    struct Idle {
        WeightTree.Tree lines;
        mapping(uint64 key => Line) line;
    }

    /// @dev Services of a line at which a match looks.
    uint256 private constant MAX_LOOKS = 4;
    /// @dev Bits of Line.latest.
    uint256 private constant LATEST = 192;

    IOrganization public immutable organization;
    IServiceListener public immutable tasks;
    /// @dev Each price is a multiple of this, in the token's smallest unit.
    uint256 private immutable _unit;
    /// @inheritdoc IServiceManager
    IProviders public immutable providers;

    uint256 private _serviceCount;
    mapping(ServiceId serviceId => Record) private _services;
    /// @dev First the services of proven providers, then the others: the first tree is marked while some of these wait.
    mapping(KindId kindId => Idle[2]) private _idle;
    /// @dev Services of proven providers that are Active.
    mapping(KindId kindId => uint256) private _provenActive;
    /// @dev Services of a provider that are not retired, 32 bits each, the first in the lowest. Not the organization's.
    mapping(address provider => uint256) private _live;

    modifier onlyTaskManager() {
        _requireTaskManager();
        _;
    }

    modifier onlyOrganization() {
        _requireOrganization();
        _;
    }

    constructor(IOrganization organization_, IServiceListener tasks_) {
        organization = organization_;
        tasks = tasks_;
        // slither-disable-next-line unused-return
        (_unit,) = Units.unitOf(organization_.token());
        providers = new Providers(organization_);
    }

    /// @inheritdoc IServiceManager
    function registerService(
        bytes32 kind,
        uint256 price,
        uint256 maxBond,
        bool autoAccept,
        string calldata description
    ) external returns (ServiceId serviceId) {
        (Terms memory terms, KindId kindId) = organization.admitService(kind, msg.sender);
        if (terms.bond > maxBond) revert BondTooHigh(terms.bond, maxBond);
        _requirePrice(price);
        Texts.requireText(description);
        serviceId = ServiceId.wrap(++_serviceCount);
        emit ServiceRegistered(serviceId, msg.sender, kind, price, autoAccept, description);
        _create(serviceId, kindId, price, autoAccept, terms);
        _offer(serviceId, _services[serviceId]);
        tasks.enter(serviceId, msg.sender, terms.bond);
    }

    /// @inheritdoc IServiceManager
    function updateService(ServiceId serviceId, uint256 price, ServiceState state) external {
        Record storage s = _get(serviceId);
        address provider = s.provider;
        if (msg.sender != provider) {
            // Whoever lost the provider's key has the bonds back this way, before penalties use them up.
            bool retires = state == ServiceState.Retired && msg.sender == providers.payoutOf(provider);
            if (!retires) revert NotProvider(serviceId, msg.sender, provider);
        }
        if (s.state == ServiceState.Retired) {
            if (state != ServiceState.Retired) revert ServiceIsRetired(serviceId);
            _collect(serviceId, s);
            return;
        }
        if (state == ServiceState.None || state > ServiceState.Retired) revert InvalidServiceState(state);
        if (s.state == ServiceState.Suspended && state != ServiceState.Retired) {
            revert ServiceIsSuspended(serviceId);
        }
        if (state == ServiceState.Active) providers.requireReady(serviceId, provider);
        _requirePrice(price);
        _setPrice(s, _leaveLine(serviceId, s.kindId, s.turn), price);
        _setState(s, state);
        emit ServiceUpdated(serviceId, price, state);
        if (_isAvailable(s)) {
            if (!s.turn.isProven()) _standBackAll(provider);
            _offer(serviceId, s);
        } else if (state == ServiceState.Retired && s.turn.taskId() == NO_TASK) {
            (uint96 bond,) = _leave(serviceId, s);
            if (bond != 0) tasks.returnBond(providers.payoutOf(provider), bond);
        }
    }

    /// @inheritdoc IServiceManager
    function agree(ServiceId serviceId) external {
        Record storage s = _get(serviceId);
        address provider = s.provider;
        if (msg.sender != provider) revert NotProvider(serviceId, msg.sender, provider);
        if (s.state == ServiceState.Retired) revert ServiceIsRetired(serviceId);
        TaskId taskId = s.turn.taskId();
        if (taskId != NO_TASK) revert ServiceIsBusy(serviceId, taskId);
        // slither-disable-next-line unused-return
        (, KindId current) = organization.admitService(organization.kindNumbered(s.kindId), provider);
        s.turn = _leaveLine(serviceId, s.kindId, s.turn);
        ServiceState state = s.state;
        // Counted among those of its kind's number while it is active.
        _setState(s, ServiceState.Paused);
        s.kindId = current;
        _setState(s, state);
        emit ServiceAgreed(serviceId, current);
        if (_isAvailable(s)) _offer(serviceId, s);
    }

    /// @inheritdoc IServiceManager
    function wakeUp() external {
        providers.wake(msg.sender);
        _offerAll(msg.sender);
    }

    /// @inheritdoc IServiceManager
    function vouch(address provider, bool vouched) external onlyOrganization {
        if (!providers.vouch(provider, vouched)) return;
        _setProven(provider, vouched);
        _offerAll(provider);
    }

    /// @inheritdoc IServiceManager
    function suspend(ServiceId serviceId) external onlyOrganization {
        Record storage s = _get(serviceId);
        if (s.state == ServiceState.Retired) revert ServiceIsRetired(serviceId);
        if (s.state == ServiceState.Suspended) revert ServiceIsSuspended(serviceId);
        _suspend(serviceId, s);
    }

    /// @inheritdoc IServiceManager
    function suspendServicesOf(address provider) external onlyOrganization {
        _suspendAll(provider);
    }

    /// @inheritdoc IServiceManager
    function reinstate(ServiceId serviceId) external onlyOrganization {
        Record storage s = _get(serviceId);
        if (s.state != ServiceState.Suspended) revert ServiceNotSuspended(serviceId, s.state);
        providers.forgive(serviceId, s.provider);
        _setState(s, ServiceState.Paused);
        emit ServiceReinstated(serviceId);
    }

    /// @inheritdoc IServiceManager
    function reserve(
        ServiceId serviceId,
        KindId kindId,
        uint256 maxPrice,
        Passed passed,
        TaskId taskId,
        Hire hired
    ) external onlyTaskManager returns (ServiceId taker, address provider, uint256 price, bool accepted) {
        taker = serviceId == NO_SERVICE ? bestIdle(kindId, maxPrice, passed, Choice.Oldest) : serviceId;
        if (taker == NO_SERVICE) return (NO_SERVICE, address(0), 0, false);
        Record storage s = _services[taker];
        if (hired == Hire.Provider && !(_isFree(s) && _priceOf(s) <= maxPrice)) {
            // slither-disable-next-line unused-return
            (ServiceId other,) = _serviceOf(s.provider, s.kindId, maxPrice);
            if (other != NO_SERVICE) (taker, s) = (other, _services[other]);
        }
        Record memory r = s;
        bool ofKind = r.kindId == kindId;
        if (hired != Hire.None && r.state == ServiceState.None) revert UnknownService(taker);
        if (hired != Hire.None && !ofKind) {
            revert ServiceOfOtherKind(taker, organization.kindNumbered(kindId));
        }
        price = _priceOf(r);
        if (!_isFree(r) || price > maxPrice || !ofKind || !_mayDo(r, passed)) {
            if (hired > r.hired) _hire(s, hired);
            return (taker, address(0), 0, false);
        }
        s.turn = _leaveLine(taker, kindId, r.turn).withTask(taskId);
        return (taker, r.provider, price, r.autoAccept);
    }

    /// @inheritdoc IServiceManager
    function release(ServiceId serviceId, Outcome outcome, uint256 value, address creator, uint40 place)
        external
        onlyTaskManager
        returns (Release memory r)
    {
        Record storage s = _services[serviceId];
        Turn turn = s.turn;
        TaskId taskId = turn.taskId();
        if (outcome == Outcome.Completed) turn = turn.withCompleted();
        else if (outcome == Outcome.Rejected) turn = turn.withRejected();
        else if (outcome == Outcome.Expired || outcome == Outcome.AbandonedLate) turn = turn.withExpired();
        r.provider = s.provider;
        Profile memory p = providers.note(Ended(serviceId, taskId, r.provider, creator, outcome, value));
        if (p.earned) {
            _setProven(r.provider, true);
            turn = turn.withProven(true);
        }
        (r.payout, r.penalty) = (p.payout, p.penalty);
        _heed(serviceId, s, p.cover);
        bool missed = outcome == Outcome.Expired || outcome == Outcome.Missed;
        if (missed && p.asleep && s.state == ServiceState.Active) {
            _setState(s, ServiceState.Paused);
            emit ServiceFellAsleep(serviceId);
        }
        turn = turn.withTask(NO_TASK);
        s.turn = turn;
        ServiceState state = s.state;
        if (state == ServiceState.Retired) (r.bond,) = _leave(serviceId, s);
        r.available = state == ServiceState.Active && !p.rests;
        if (r.available && !_mayWait(turn, r.provider)) {
            r.available = false;
            emit ServiceStoodBack(serviceId);
        }
        if (r.available && place != 0) s.turn = _enqueue(serviceId, s, p.grade, turn, place);
    }

    /// @inheritdoc IServiceManager
    function conclude(
        ServiceId serviceId,
        TaskId taskId,
        Outcome outcome,
        uint256 value,
        address creator,
        uint96 penalty
    ) external onlyTaskManager returns (Release memory r) {
        Record storage s = _services[serviceId];
        address provider = s.provider;
        bool retired = s.state == ServiceState.Retired;
        Profile memory p =
            providers.conclude(Ended(serviceId, taskId, provider, creator, outcome, value), penalty, retired);
        (r.provider, r.payout, r.penalty, r.bond) = (provider, p.payout, p.penalty, p.bond);
        if (outcome == Outcome.Completed) s.turn = s.turn.withCompleted();
        else if (outcome == Outcome.Rejected) s.turn = s.turn.withRejected();
        if (p.earned) _setProven(provider, true);
        if (outcome == Outcome.Void && p.rests) _standBackAll(provider);
        _heed(serviceId, s, p.cover);
        if (p.cover != Cover.Enough || s.state != ServiceState.Short) return r;
        _setState(s, p.asleep ? ServiceState.Paused : ServiceState.Active);
        r.available = _isFree(s);
    }

    /// @inheritdoc IServiceManager
    function enqueue(ServiceId serviceId, uint40 place) external onlyTaskManager {
        Record storage s = _get(serviceId);
        Turn turn = s.turn;
        if (!_isAvailable(s) || turn.place() != 0) revert ServiceNotIdle(serviceId);
        // slither-disable-next-line unused-return
        (, uint64 grade,) = providers.recordOf(s.provider);
        s.turn = _enqueue(serviceId, s, grade, turn, place);
    }

    /// @inheritdoc IServiceManager
    function service(ServiceId serviceId) external view returns (Service memory) {
        Record storage s = _get(serviceId);
        Agreement memory a = providers.agreementOf(serviceId);
        // slither-disable-next-line unused-return
        (uint64 reputation,, uint8 failures) = providers.recordOf(s.provider);
        return Service({
            provider: s.provider,
            price: _priceOf(s),
            kind: organization.kindNumbered(s.kindId),
            taskId: s.turn.taskId(),
            place: s.turn.place(),
            state: s.state,
            completed: s.turn.completed(),
            rejected: s.turn.rejected(),
            expired: s.turn.expired(),
            reputation: uint8(reputation),
            bond: a.bond,
            penalty: a.penalty,
            maxFailures: a.maxFailures,
            failures: failures,
            autoAccept: s.autoAccept,
            proven: s.turn.isProven(),
            namers: a.namers,
            maxVoids: a.maxVoids
        });
    }

    /// @inheritdoc IServiceManager
    function providerOf(ServiceId serviceId) external view returns (address) {
        return _get(serviceId).provider;
    }

    /// @inheritdoc IServiceManager
    function wants(ServiceId serviceId) external view returns (Free memory) {
        Record storage s = _services[serviceId];
        Turn turn = s.turn;
        bool offered = turn.isProven() || _provenActive[s.kindId] == 0;
        return Free(s.kindId, _priceOf(s), _named(serviceId, s), turn.number(), offered);
    }

    /// @inheritdoc IServiceManager
    function profile(ServiceId serviceId) external view returns (uint32 number, bool proven, bool isOffered) {
        Record storage s = _get(serviceId);
        proven = s.turn.isProven();
        return (s.turn.number(), proven, proven || _provenActive[s.kindId] == 0);
    }

    /// @inheritdoc IServiceManager
    function serviceOf(address provider, bytes32 kind, uint256 maxPrice)
        external
        view
        returns (ServiceId serviceId, uint256 all)
    {
        (serviceId, all) = _serviceOf(provider, organization.numberOf(kind), maxPrice);
        if (serviceId == NO_SERVICE) revert ProviderWithoutService(provider, kind);
    }

    /// @inheritdoc IServiceManager
    function serviceCount() external view returns (uint256) {
        return _serviceCount;
    }

    /// @inheritdoc IServiceManager
    function bestIdle(KindId kindId, uint256 maxPrice, Passed passed, Choice choice)
        public
        view
        returns (ServiceId best)
    {
        uint64 lastKey = _lastKey(maxPrice);
        Idle[2] storage idle = _idle[kindId];
        best = _firstIdle(idle[0], lastKey, passed, choice);
        if (!idle[0].lines.marked || (passed.isForProven() && _provenActive[kindId] != 0)) return best;
        ServiceId other = _firstIdle(idle[1], lastKey, passed, choice);
        if (best == NO_SERVICE) return other;
        if (other == NO_SERVICE) return best;
        return _rank(_services[other].turn, choice) < _rank(_services[best].turn, choice) ? other : best;
    }

    /// @dev A service of the caller, which is active and in no line yet.
    function _create(ServiceId serviceId, KindId kindId, uint256 price, bool autoAccept, Terms memory terms)
        private
    {
        assert(serviceId.pack() <= MAX_NUMBER);
        if (msg.sender != address(organization)) _addLive(msg.sender, serviceId);
        (uint32 number, bool proven, bool hired) = providers.enter(msg.sender, serviceId, terms);
        Record storage s = _services[serviceId];
        (s.provider, s.kindId, s.autoAccept) = (msg.sender, kindId, autoAccept);
        _setPrice(s, NO_TURN.withNumber(number).withProven(proven), price);
        _setState(s, ServiceState.Active);
        if (hired) s.hired = Hire.Provider;
    }

    /// @dev The first service that the task has not passed, among the first MAX_LOOKS.
    function _firstIdle(Idle storage idle, uint64 lastKey, Passed passed, Choice choice)
        private
        view
        returns (ServiceId)
    {
        (uint256 looks, uint256 skipped, uint64 key) = (MAX_LOOKS, 0, 0);
        while (true) {
            if (choice == Choice.Oldest) key = idle.lines.greatestMajor(lastKey, skipped);
            else if (choice == Choice.Cheapest) key = idle.lines.first(0, key + 1);
            else key = idle.lines.greatestMinor(lastKey, skipped);
            if (key == 0 || key > lastKey) return NO_SERVICE;
            Line storage line = idle.line[key];
            for (uint32 id = line.first; id != 0; id = _behind(line, id)) {
                ServiceId serviceId = unpackService(id);
                if (passed.isEmpty() || !passed.has(_services[serviceId].turn.number())) return serviceId;
                if (--looks == 0) return NO_SERVICE;
            }
            skipped = skipped << 64 | key;
        }
        return NO_SERVICE;
    }

    /// @dev The service behind this one in its line; 0 if it is the last.
    function _behind(Line storage line, uint32 id) private view returns (uint32 next) {
        next = _services[unpackService(id)].turn.next();
        if (next != 0) return next;
        for (uint192 latest = line.latest; uint32(latest) != id; latest >>= 32) {
            next = uint32(latest);
        }
    }

    /// @dev Of two services that wait the one with the lower rank is chosen. A line's key has the price before the reputation.
    function _rank(Turn turn, Choice choice) private pure returns (uint256) {
        uint256 place = turn.place();
        if (choice == Choice.Oldest) return place;
        uint256 key = turn.line();
        if (choice == Choice.MostReputable) key |= (key & MAX_MINOR) << 24;
        return key << 40 | place;
    }

    /// @dev The cheapest of the provider's services that is free, else any; 0 if it has none. And all of them.
    function _serviceOf(address provider, KindId kindId, uint256 maxPrice)
        private
        view
        returns (ServiceId serviceId, uint256 all)
    {
        uint256 lowest = maxPrice + 1;
        for (uint256 live = _live[provider]; live != 0; live >>= 32) {
            ServiceId each = unpackService(uint32(live));
            Record storage s = _services[each];
            if (s.kindId != kindId) continue;
            all = all << 32 | each.pack();
            bool better = _isFree(s) && _priceOf(s) < lowest;
            if (better) lowest = _priceOf(s);
            if (better || serviceId == NO_SERVICE) serviceId = each;
        }
    }

    /// @dev A task waits for this service, or for any of its provider: for these at most MAX_SERVICES, and later ones.
    function _hire(Record storage s, Hire hired) private {
        if (hired == Hire.Service) {
            s.hired = hired;
            return;
        }
        address provider = s.provider;
        providers.setHired(provider);
        for (uint256 live = _live[provider]; live != 0; live >>= 32) {
            _services[unpackService(uint32(live))].hired = hired;
        }
    }

    /// @dev See Release.
    function _named(ServiceId serviceId, Record storage s) private view returns (uint160) {
        Hire hired = s.hired;
        if (hired == Hire.None) return 0;
        return hired == Hire.Service ? uint160(ServiceId.unwrap(serviceId)) : uint160(s.provider);
    }

    function _setPrice(Record storage s, Turn turn, uint256 price) private {
        s.units = uint64(price / _unit);
        s.turn = turn.withLine(uint24(_key(Units.levelFor(price, _unit), 0)));
    }

    /// @dev Behind the other services of its kind, price and reputation. Returns the service's turn with that place.
    function _enqueue(ServiceId serviceId, Record storage s, uint64 grade, Turn turn, uint40 place)
        private
        returns (Turn)
    {
        turn = turn.withPlace(place).withLineOfProven(turn.isProven());
        Idle storage idle = _idle[s.kindId][turn.isProven() ? 0 : 1];
        uint64 key = (turn.line() | MAX_MINOR) ^ grade;
        Line storage line = idle.line[key];
        (uint32 id, uint192 latest) = (serviceId.pack(), line.latest);
        if (latest == 0) {
            (line.first, line.used) = (id, true);
            idle.lines.put(key, _weight(place, grade));
            if (!turn.isProven()) _idle[s.kindId][0].lines.marked = true;
        } else if (latest >> (LATEST - 32) != 0) {
            // The earliest of the latest is one of the others now.
            Record storage earliest = _services[unpackService(uint32(latest >> (LATEST - 32)))];
            earliest.turn = earliest.turn.withNext(uint32(latest >> (LATEST - 64)));
        }
        line.latest = latest << 32 | id;
        return turn.withLine(uint24(key)).withPrevious(uint32(latest));
    }

    /// @dev Out of its line, wherever it stands, if it waits. Returns the service's turn without that place.
    function _leaveLine(ServiceId serviceId, KindId kindId, Turn turn) private returns (Turn) {
        if (turn.place() == 0) return turn;
        Idle storage idle = _idle[kindId][turn.isLineOfProven() ? 0 : 1];
        (uint64 key, uint32 id) = (turn.line(), serviceId.pack());
        Line storage line = idle.line[key];
        (uint32 previous, uint32 next, bool known) = (turn.previous(), turn.next(), true);
        turn = turn.withPlace(0).withNext(0);
        if (next == 0) (next, known) = _leaveLatest(line, id);
        if (line.first != id) {
            if (known) {
                Record storage before = _services[unpackService(previous)];
                before.turn = before.turn.withNext(next);
                if (next == 0) line.latest = previous;
            }
            if (next != 0) {
                Record storage behind = _services[unpackService(next)];
                behind.turn = behind.turn.withPrevious(previous);
            }
        } else if (next == 0) {
            line.first = 0;
            idle.lines.remove(key);
            if (!turn.isLineOfProven() && idle.lines.root == 0) _idle[kindId][0].lines.marked = false;
        } else {
            line.first = next;
            // The oldest line keeps its earlier age while it stays the oldest of all.
            if (!idle.lines.isAlone()) {
                Turn oldest = _services[unpackService(next)].turn;
                Weight weight = _weight(oldest.place(), MAX_MINOR - (oldest.line() & MAX_MINOR));
                if (!idle.lines.leads(key, weight)) idle.lines.put(key, weight);
            }
        }
        return turn;
    }

    /// @dev Out of the latest of its line, among which it is. Returns who is behind it, 0 for nobody, and whether the service
    /// before it, if there is one, is none of the latest, and so knows the next by itself.
    function _leaveLatest(Line storage line, uint32 id) private returns (uint32 next, bool known) {
        (uint192 latest, uint256 behind) = (line.latest, 0);
        for (; uint32(latest >> behind) != id; behind += 32) {
            next = uint32(latest >> behind);
        }
        uint192 before = latest >> (behind + 32);
        known = before == 0;
        line.latest = before << behind | (latest & uint192((1 << behind) - 1));
    }

    /// @dev What is left of the bond, or a provider that fails again and again, is a reason to give the service no more work.
    function _heed(ServiceId serviceId, Record storage s, Cover cover) private {
        if (cover == Cover.Enough) return;
        if (cover != Cover.Short) {
            _suspend(serviceId, s);
            if (cover == Cover.Failing) _suspendAll(s.provider);
        } else if (s.state == ServiceState.Active) {
            _setState(s, ServiceState.Short);
            emit BondRanShort(serviceId);
        }
    }

    /// @dev The provider is proven from now on, or no longer: each of its services says so, and active ones are counted.
    function _setProven(address provider, bool proven) private {
        for (uint256 live = _live[provider]; live != 0; live >>= 32) {
            Record storage s = _services[unpackService(uint32(live))];
            s.turn = s.turn.withProven(proven);
            if (s.state == ServiceState.Active) _countProven(s.kindId, proven);
        }
    }

    /// @dev One more service of a proven provider is active, or one less.
    function _countProven(KindId kindId, bool more) private {
        if (more) ++_provenActive[kindId];
        else --_provenActive[kindId];
    }

    /// @dev At most MAX_SERVICES. The organization answers for its own.
    function _suspendAll(address provider) private {
        for (uint256 live = _live[provider]; live != 0; live >>= 32) {
            ServiceId serviceId = unpackService(uint32(live));
            _suspend(serviceId, _services[serviceId]);
        }
    }

    function _suspend(ServiceId serviceId, Record storage s) private {
        if (s.state == ServiceState.Retired || s.state == ServiceState.Suspended) return;
        s.turn = _leaveLine(serviceId, s.kindId, s.turn);
        _setState(s, ServiceState.Suspended);
        emit ServiceSuspended(serviceId);
    }

    /// @dev All changes of state, because active services of proven providers are counted.
    function _setState(Record storage s, ServiceState next) private {
        bool before = s.state == ServiceState.Active;
        s.state = next;
        bool active = next == ServiceState.Active;
        if (before != active && s.turn.isProven()) _countProven(s.kindId, active);
    }

    /// @dev Give an available service that is in no line its next task, or let it wait, or stand back.
    function _offer(ServiceId serviceId, Record storage s) private {
        if (_mayWait(s.turn, s.provider)) tasks.onServiceFree(serviceId);
        else emit ServiceStoodBack(serviceId);
    }

    /// @dev Put the provider's services into line again, in the line where they belong now.
    function _offerAll(address provider) private {
        for (uint256 live = _live[provider]; live != 0; live >>= 32) {
            ServiceId serviceId = unpackService(uint32(live));
            Record storage s = _services[serviceId];
            Turn turn = s.turn;
            bool placed = turn.place() != 0 && turn.isLineOfProven() == turn.isProven();
            if (placed || !_isAvailable(s)) continue;
            s.turn = _leaveLine(serviceId, s.kindId, s.turn);
            _offer(serviceId, s);
        }
    }

    /// @dev The services of a provider that is not proven leave their line: it has one there at most.
    function _standBackAll(address provider) private {
        for (uint256 live = _live[provider]; live != 0; live >>= 32) {
            ServiceId serviceId = unpackService(uint32(live));
            Record storage s = _services[serviceId];
            if (s.turn.place() == 0) continue;
            s.turn = _leaveLine(serviceId, s.kindId, s.turn);
            emit ServiceStoodBack(serviceId);
        }
    }

    /// @dev Whether a service that neither waits nor works may wait: one of a provider that is not proven stands back while
    /// the provider rests, or another one of it waits or works.
    function _mayWait(Turn turn, address provider) private view returns (bool) {
        if (turn.isProven()) return true;
        for (uint256 live = _live[provider]; live != 0; live >>= 32) {
            Turn other = _services[unpackService(uint32(live))].turn;
            if (other.place() != 0 || other.taskId() != NO_TASK) return false;
        }
        return !providers.rests(provider);
    }

    /// @dev The service is over, and its bond is for its provider: not before `until`, if that is not 0.
    function _leave(ServiceId serviceId, Record storage s) private returns (uint96 bond, uint256 until) {
        (bond, until) = providers.takeBond(serviceId, s.provider);
        if (until != 0) return (0, until);
        (uint256 live, uint256 kept) = (_live[s.provider], 0);
        for (uint256 shift = 0; live != 0; live >>= 32) {
            if (uint32(live) == serviceId.pack()) continue;
            kept |= uint256(uint32(live)) << shift;
            shift += 32;
        }
        _live[s.provider] = kept;
    }

    /// @dev The bond of a service that retired before, and had to wait.
    function _collect(ServiceId serviceId, Record storage s) private {
        if (s.turn.taskId() != NO_TASK) revert ServiceIsRetired(serviceId);
        (uint96 bond, uint256 until) = _leave(serviceId, s);
        if (until != 0) revert BondIsLocked(serviceId, until);
        if (bond == 0) revert ServiceIsRetired(serviceId);
        tasks.returnBond(providers.payoutOf(s.provider), bond);
    }

    function _addLive(address provider, ServiceId serviceId) private {
        (uint256 live, uint256 shift) = (_live[provider], 0);
        while (live >> shift != 0) shift += 32;
        if (shift == 32 * MAX_SERVICES) revert TooManyServices(provider, MAX_SERVICES);
        _live[provider] = live | uint256(serviceId.pack()) << shift;
    }

    function _isAvailable(Record memory s) private pure returns (bool) {
        return s.state == ServiceState.Active && s.turn.taskId() == NO_TASK;
    }

    /// @dev Whether it can be given a task: it waits, or may.
    function _isFree(Record memory s) private view returns (bool) {
        return _isAvailable(s) && (s.turn.place() != 0 || _mayWait(s.turn, s.provider));
    }

    /// @dev Whether a task may be offered to the service that has passed these providers.
    function _mayDo(Record memory s, Passed passed) private view returns (bool) {
        if (passed.isEmpty()) return true;
        if (passed.has(s.turn.number())) return false;
        return !passed.isForProven() || _provenActive[s.kindId] == 0 || s.turn.isProven();
    }

    function _get(ServiceId serviceId) private view returns (Record storage s) {
        s = _services[serviceId];
        if (s.provider == address(0)) revert UnknownService(serviceId);
    }

    /// @dev Before or at this key are the lines that cost at most `price`.
    function _lastKey(uint256 price) private view returns (uint64) {
        return _key(Units.levelOf(price, _unit), 0);
    }

    /// @dev Cheap before dear, then reputable before not; never 0.
    function _key(uint64 level, uint64 reputation) private pure returns (uint64) {
        return Weight.unwrap(weigh(level + 1, MAX_MINOR - reputation));
    }

    function _priceOf(Record memory s) private view returns (uint96) {
        return uint96(s.units * _unit);
    }

    /// @dev The weight of a line whose first service has this place.
    function _weight(uint40 place, uint64 reputation) private pure returns (Weight) {
        return weigh(MAX_MAJOR - place, reputation);
    }

    function _requirePrice(uint256 price) private view {
        if (!Units.isPrice(price, _unit)) revert InvalidPrice(price, _unit, Units.max(_unit));
    }

    function _requireTaskManager() private view {
        if (msg.sender != address(tasks)) revert NotTaskManager(msg.sender);
    }

    function _requireOrganization() private view {
        if (msg.sender != address(organization)) revert NotOrganization(msg.sender);
    }
}
